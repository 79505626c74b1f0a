"""Merging of two maps that show the same place."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_change import Move


def merge_maps(atlas: Atlas, i: int, c: int, T_c_i: FloatArray) -> Move:
    """Move the newer of two maps, the one with the larger id, into the frame of the older one.

    Returns the motion of its keyframes. In the spanning tree, the keyframe of the older map
    becomes the parent of the other one.

    Args:
        i: Row of a keyframe of one map.
        c: Row of a keyframe of the other map.
        T_c_i: (4, 4) measured pose of keyframe `i` relative to keyframe `c`.
    """
    keyframes = atlas.keyframes
    if keyframes.map_id[i] < keyframes.map_id[c]:
        i, c, T_c_i = c, i, se3.inverse(T_c_i)
    rows = np.flatnonzero(keyframes.alive & (keyframes.map_id == keyframes.map_id[i]))
    T_map_i = keyframes.T_map_camera[c] @ T_c_i
    T_new_old = se3.orthonormalized(T_map_i @ se3.inverse(keyframes.T_map_camera[i]))
    moves = np.tile(T_new_old, (len(rows), 1, 1))
    move = atlas.move(rows, moves, int(keyframes.map_id[c]))
    _reroot(atlas, i, c)
    return move


def _reroot(atlas: Atlas, i: int, parent: int) -> None:
    """Make keyframe `i` the root of its spanning tree, and give it a parent in another tree."""
    keyframes = atlas.keyframes
    child: int | None = i
    while child is not None:
        old_parent = keyframes.index_of(int(keyframes.parent_uid[child]))
        atlas.set_parent(child, parent)
        parent, child = child, old_parent
