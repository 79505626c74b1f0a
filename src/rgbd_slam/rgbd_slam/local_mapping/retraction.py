"""Retraction of a keyframe's observations of objects that turned out to be dynamic."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FeatureVerdicts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT


def retract_observations(atlas: Atlas, verdicts: FeatureVerdicts) -> None:
    """Remove the observations of a keyframe's dynamic features, and the points based on them.

    Points that another keyframe created only lose these observations. Nothing is removed if the
    image is not a keyframe of this session, or has another number of features.
    """
    keyframes, points = atlas.keyframes, atlas.points
    rows = np.flatnonzero(
        keyframes.alive & ~keyframes.is_loaded & (keyframes.stamp_ns == verdicts.stamp_ns)
    )
    if len(rows) == 0:
        return
    # The newest, because a looped bag repeats its stamps.
    i = int(rows[np.argmax(keyframes.uid[rows])])
    if len(verdicts.is_dynamic) != keyframes.num_features[i]:
        return
    k = np.flatnonzero(verdicts.is_dynamic)
    atlas.forbid_seeds(i, k)
    j = keyframes.points_of(i)[k]
    j = j[j != NO_POINT]
    is_made_here = points.first_keyframe_uid[j] == keyframes.uid[i]
    atlas.remove_points(j[is_made_here])
    atlas.unobserve(i, k)
    atlas.refresh(j[~is_made_here])
    atlas.update_connections(i)
