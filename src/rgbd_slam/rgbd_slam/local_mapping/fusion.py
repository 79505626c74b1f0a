"""Fusion of duplicate points: projects the points of a keyframe into its neighbors and back."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import MappingConfig
from rgbd_slam.matching.local_map import visible_points
from rgbd_slam.matching.matching import match_by_projection
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, CHI2_STEREO

# Half side of the search window of `matching.local_map` for points seen obliquely; the argument
# `radius` of `visible_points` is a factor on it.
_OBLIQUE_RADIUS_PX = 4.0


def fuse_with_neighbors(atlas: Atlas, camera: StereoCamera, i: int, config: MappingConfig) -> None:
    """Fuse points of keyframe `i` and of its neighbors that project to the same features.

    If a point matches a feature that observes no point yet and may create one, the feature becomes
    an observation of the point.
    """
    neighbors = atlas.covisible(i, limit=config.neighbors)
    for neighbor in neighbors.tolist():
        own = atlas.keyframes.point_of_feature[i]
        fuse(atlas, camera, neighbor, own[own != NO_POINT].astype(np.int64), config)
    fuse(atlas, camera, i, atlas.points_of(neighbors), config)
    seen = atlas.keyframes.point_of_feature[i]
    atlas.refresh(seen[seen != NO_POINT].astype(np.int64))


def fuse(atlas: Atlas, camera: StereoCamera, i: int, j: IntArray, config: MappingConfig) -> None:
    """Search points (P,) in keyframe `i`, and add observations or fuse them with its points.

    Features that observe no point and may not create one (`may_seed`) are not changed.
    """
    keyframes = atlas.keyframes
    own = keyframes.point_of_feature[i]
    is_known = np.isin(j, own, kind='sort')
    T_camera_map = se3.inverse(keyframes.T_map_camera[i])
    radius = config.fuse_radius_px / _OBLIQUE_RADIUS_PX
    view = visible_points(atlas, camera, T_camera_map, np.unique(j[~is_known]), radius)
    frame = keyframes.frame(i)
    matches = match_by_projection(view.queries, frame, config.max_hamming, 1.0)
    measured = frame.measurement_px[matches.k].T
    error2 = (measured - view.queries.projection_px[:, matches.q]) ** 2
    stereo = np.isfinite(measured[2])
    chi2 = error2[0] + error2[1] + np.where(stereo, error2[2], 0.0)
    chi2 /= atlas.octave_scale[frame.octave[matches.k]] ** 2
    fits = chi2 < np.where(stereo, CHI2_STEREO, CHI2_MONO)
    fits &= keyframes.may_seed[i, matches.k] | (own[matches.k] != NO_POINT)
    _join(atlas, i, matches.k[fits], view.points[matches.q[fits]])


def _join(atlas: Atlas, i: int, k: IntArray, j: IntArray) -> None:
    """Add observations of points by features of keyframe `i`, or fuse the points with theirs."""
    points = atlas.points
    present = atlas.keyframes.point_of_feature[i, k].astype(np.int64)
    is_free = present == NO_POINT
    atlas.observe(i, k[is_free], j[is_free])
    new, old = j[~is_free], present[~is_free]
    swap = points.num_observations[new] < points.num_observations[old]
    atlas.replace_points(np.where(swap, new, old), np.where(swap, old, new))
