"""Culling of unreliable new points and of redundant keyframes.

The rules are those of ORB-SLAM (Mur-Artal et al., T-RO 2015, sec. VI).
"""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import MappingConfig
from rgbd_slam.matching.local_map import visible_points
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_tables import NEAR_SHARED

# ORB-SLAM3, LocalMapping.cc, MapPointCulling. A point is new up to the age _NEW_AGE. From the age
# _MIN_AGE on, it needs more than _MIN_WEIGHT observations, where one with depth counts twice. The
# age is the number of keyframes since the one that created the point.
_NEW_AGE = 3
_MIN_AGE = 2
_MIN_WEIGHT = 3
# Other keyframes that must observe a redundant point (ORB-SLAM3, KeyFrameCulling).
_MIN_OBSERVERS = 3
_MIN_CLOSE = 30  # not tuned: with fewer close points, all points of a keyframe are considered


def cull_new_points(atlas: Atlas, camera: StereoCamera, i: int, config: MappingConfig) -> None:
    """Remove new points that few frames find, or that keyframe `i` should observe but does not.

    A point is weak if it has at most three observations, where one with depth counts twice. A
    point that is weak, or at most three keyframes old, is removed if it was found in less than the
    ratio `min_found_ratio` of the frames that should show it. A weak point that is at least two
    keyframes old is removed if it should be visible in keyframe `i`, but the keyframe does not
    observe it. Only points around keyframe `i` are tested, whatever the size of the map.
    """
    points, uid = atlas.points, atlas.keyframes.uid[i]
    j = atlas.points_of(_around(atlas, i))
    weight = points.num_observations[j] + points.num_stereo[j]
    age = uid - points.first_keyframe_uid[j]
    is_weak = weight <= _MIN_WEIGHT
    is_new = is_weak | (age <= _NEW_AGE)
    is_lost = is_new & (points.num_found[j] < config.min_found_ratio * points.num_visible[j])
    due = j[is_weak & (age >= _MIN_AGE)]
    T_camera_map = se3.inverse(atlas.keyframes.T_map_camera[i])
    unseen = visible_points(atlas, camera, T_camera_map, due, 1.0).points
    unseen = np.setdiff1d(unseen, atlas.keyframes.point_of_feature[i])
    atlas.remove_points(np.union1d(j[is_lost], unseen))


def _around(atlas: Atlas, i: int) -> IntArray:
    """Return the rows of keyframe `i`, its parent, and the keyframes covisible with the parent."""
    parent = atlas.keyframes.index_of(int(atlas.keyframes.parent_uid[i]))
    return np.array([i]) if parent is None else np.r_[i, parent, atlas.covisible(parent)]


def cull_keyframes(atlas: Atlas, i: int, config: MappingConfig, close_limit_m: float) -> None:
    """Remove neighbors of keyframe `i` whose close points are nearly all seen by three others.

    At least three other keyframes must observe more than `redundant_share` of a neighbor's close
    points, in an octave at most one above that in the neighbor. If hardly any point is close, as
    in a hall, all points count.
    """
    for neighbor in atlas.covisible(i, NEAR_SHARED).tolist():
        if _is_redundant(atlas, neighbor, config.redundant_share, close_limit_m):
            atlas.remove_keyframe(neighbor)


def _is_redundant(atlas: Atlas, i: int, share: float, close_limit_m: float) -> bool:
    keyframes, points = atlas.keyframes, atlas.points
    if keyframes.index_of(int(keyframes.parent_uid[i])) is None:
        return False  # the root of a map defines its frame
    j = keyframes.point_of_feature[i]
    depth = keyframes.depth_m[i]
    seen_here = j != NO_POINT
    close = seen_here & (depth > 0) & (depth < close_limit_m)
    k = np.flatnonzero(close if np.count_nonzero(close) >= _MIN_CLOSE else seen_here)
    j = j[k].astype(np.int64)
    many = points.num_observations[j] > _MIN_OBSERVERS
    order = np.argsort(j[many])
    candidates, octave = j[many][order], keyframes.octave[i, k[many][order]].astype(np.int64)
    seen = atlas.observations_of(candidates, atlas.covisible(i))
    n = np.searchsorted(candidates, seen.j)
    fine = keyframes.octave[seen.i, seen.k] <= octave[n] + 1
    observers = np.bincount(n[fine], minlength=len(candidates))
    redundant = np.count_nonzero(observers >= _MIN_OBSERVERS)
    return bool(redundant > share * len(j))
