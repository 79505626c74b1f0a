"""Making one map of two that were found to show the same place."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import SlamMap


def merge_maps(slam_map: SlamMap, i: int, c: int, T_c_i: FloatArray) -> None:
    """Bring the younger of two maps into the frame of the older, which users know.

    Args:
        i, c: a keyframe of each map.
        T_c_i: (4, 4) the second's camera to the first's.
    """
    map_id = slam_map.keyframes.map_id
    if map_id[i] > map_id[c]:
        _adopt(slam_map, c, i, T_c_i)
    else:
        _adopt(slam_map, i, c, se3.inverse(T_c_i))


def _adopt(slam_map: SlamMap, host: int, guest: int, T_host_guest: FloatArray) -> None:
    """Move the guest's map into the host's, and hang its tree there."""
    keyframes, points = slam_map.keyframes, slam_map.points
    old, new = int(keyframes.map_id[guest]), int(keyframes.map_id[host])
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == old))
    j = np.flatnonzero(points.alive & (points.map_id == old))
    T_map_guest = keyframes.T_map_camera[host] @ T_host_guest
    T_new_old = se3.orthonormalized(T_map_guest @ se3.inverse(keyframes.T_map_camera[guest]))
    slam_map.set_poses(rows, T_new_old @ keyframes.T_map_camera[rows])
    slam_map.set_positions(j, se3.transform(T_new_old, points.position_m[j]))
    slam_map.set_map_id(rows, j, new)
    _hang(slam_map, guest, host)
    slam_map.refresh(j)


def _hang(slam_map: SlamMap, i: int, parent: int) -> None:
    """Turn the links above `i` round, so that it is its tree's root, and hang it on `parent`."""
    keyframes = slam_map.keyframes
    child: int | None = i
    above = parent
    while child is not None:
        next_above = keyframes.index_of(int(keyframes.parent_uid[child]))
        slam_map.set_parent(child, above)
        above, child = child, next_above
