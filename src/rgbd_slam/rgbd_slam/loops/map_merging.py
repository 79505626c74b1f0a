"""Merging of two maps that show the same place."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_change import Move


def merge_maps(atlas: Atlas, i: int, c: int, T_c_i: FloatArray) -> Move:
    """Move the newer of two maps into the frame of the older one, which is already in use.

    The newer map is the one with the larger id; its keyframes and points get the id of the older
    one. Returns the motion of its keyframes.

    Args:
        atlas: The maps.
        i: Row of a keyframe of one map.
        c: Row of a keyframe of the other map.
        T_c_i: (4, 4) measured pose of keyframe `i` relative to keyframe `c`.
    """
    map_id = atlas.keyframes.map_id
    if map_id[i] > map_id[c]:
        return _adopt(atlas, c, i, T_c_i)
    return _adopt(atlas, i, c, se3.inverse(T_c_i))


def _adopt(atlas: Atlas, host: int, guest: int, T_host_guest: FloatArray) -> Move:
    """Move the map of keyframe `guest` into the map of keyframe `host`; return the motion.

    `host` becomes the parent of `guest` in the spanning tree.
    """
    keyframes = atlas.keyframes
    old, new = int(keyframes.map_id[guest]), int(keyframes.map_id[host])
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == old))
    T_map_guest = keyframes.T_map_camera[host] @ T_host_guest
    T_new_old = se3.orthonormalized(T_map_guest @ se3.inverse(keyframes.T_map_camera[guest]))
    move = atlas.move(rows, np.tile(T_new_old, (len(rows), 1, 1)), new)
    _reroot(atlas, guest, host)
    return move


def _reroot(atlas: Atlas, i: int, parent: int) -> None:
    """Make a keyframe the root of its spanning tree, and give it a parent in another tree.

    `i` and `parent` are rows.
    """
    keyframes = atlas.keyframes
    child: int | None = i
    new_parent = parent
    while child is not None:
        old_parent = keyframes.index_of(int(keyframes.parent_uid[child]))
        atlas.set_parent(child, new_parent)
        new_parent, child = child, old_parent
