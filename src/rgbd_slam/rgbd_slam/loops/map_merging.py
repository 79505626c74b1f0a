"""Making one map of two that were found to show the same place."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas


def merge_maps(atlas: Atlas, i: int, c: int, T_c_i: FloatArray) -> None:
    """Bring the younger of two maps into the frame of the older, which users know.

    Args:
        i, c: a keyframe of each map.
        T_c_i: (4, 4) the second's camera to the first's.
    """
    map_id = atlas.keyframes.map_id
    if map_id[i] > map_id[c]:
        _adopt(atlas, c, i, T_c_i)
    else:
        _adopt(atlas, i, c, se3.inverse(T_c_i))


def _adopt(atlas: Atlas, host: int, guest: int, T_host_guest: FloatArray) -> None:
    """Move the guest's map into the host's, and hang its tree there."""
    keyframes, points = atlas.keyframes, atlas.points
    old, new = int(keyframes.map_id[guest]), int(keyframes.map_id[host])
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == old))
    j = np.flatnonzero(points.alive & (points.map_id == old))
    T_map_guest = keyframes.T_map_camera[host] @ T_host_guest
    T_new_old = se3.orthonormalized(T_map_guest @ se3.inverse(keyframes.T_map_camera[guest]))
    atlas.set_poses(rows, T_new_old @ keyframes.T_map_camera[rows])
    atlas.set_positions(j, se3.transform(T_new_old, points.position_m[j]))
    atlas.set_map_id(rows, j, new)
    _hang(atlas, guest, host)
    atlas.refresh(j)


def _hang(atlas: Atlas, i: int, parent: int) -> None:
    """Turn the links above `i` round, so that it is its tree's root, and hang it on `parent`."""
    keyframes = atlas.keyframes
    child: int | None = i
    above = parent
    while child is not None:
        next_above = keyframes.index_of(int(keyframes.parent_uid[child]))
        atlas.set_parent(child, above)
        above, child = child, next_above
