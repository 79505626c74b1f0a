"""Takes back what a keyframe saw on what turned out to move."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FeatureVerdicts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT


def take_back(atlas: Atlas, verdicts: FeatureVerdicts) -> None:
    """Forget what a keyframe's dynamic features see, and the points that were made of them.

    Args:
        atlas: The map.
        verdicts: On the features of a frame; without a keyframe of it, nothing happens.
    """
    keyframes, points = atlas.keyframes, atlas.points
    rows = np.flatnonzero(
        keyframes.alive & ~keyframes.is_loaded & (keyframes.stamp_ns == verdicts.stamp_ns)
    )
    if len(rows) == 0:
        return
    i = int(rows[np.argmax(keyframes.uid[rows])])  # stamps of a bag that loops come again
    if len(verdicts.is_dynamic) != keyframes.num_features[i]:
        return
    k = np.flatnonzero(verdicts.is_dynamic)
    atlas.forbid_seeds(i, k)
    j = keyframes.points_of(i)[k]
    j = j[j != NO_POINT]
    made = points.first_keyframe_uid[j] == keyframes.uid[i]
    atlas.remove_points(j[made])
    atlas.unobserve(i, k)
    atlas.refresh(j[~made])
    atlas.update_connections(i)
