"""A saved map of any size: copies of a small one beside each other, which look different."""

from __future__ import annotations

import numpy as np

from hoid_benchmarks.building.world.landmarks import DESCRIPTOR_BYTES
from hoid_common.io.records import Array
from rgbd_slam.model.map_state import NONE, MapState
from rgbd_slam.store.map_file import MapFile

_APART_M = 400.0
BASE_KEYFRAMES = 100  # number of keyframes of the map that the benchmarks repeat


def tiled(content: MapFile, count: int, seed: int = 0) -> MapFile:
    """Return a map of `count` copies; the first one is the map itself.

    All descriptors of a copy are XORed with one random mask: this keeps the distances within a
    copy, and makes those between copies the distances of unrelated descriptors. The root of a
    copy becomes a child of the last keyframe of the copy before.
    """
    state, rng = content.map, np.random.default_rng(seed)
    masks = rng.integers(0, 256, (count, DESCRIPTOR_BYTES), dtype=np.uint8)
    masks[0] = 0
    parts = [_copy(state, n, mask) for n, mask in enumerate(masks)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return content._replace(map=MapState.of(columns), uids=None, loops=())


def tiled_to(base: MapFile, num_keyframes: int, seed: int) -> MapFile:
    """Return copies of a map of `BASE_KEYFRAMES` with about that many keyframes."""
    return tiled(base, max(round(num_keyframes / BASE_KEYFRAMES), 1), seed)


def _copy(state: MapState, n: int, mask: Array) -> dict[str, Array]:
    """Return the columns of copy `n`; the rows of the previous copies come first in the map."""
    keyframes, points = n * len(state), n * len(state.position_m)
    T_map_camera, position_m = state.T_map_camera.copy(), state.position_m.copy()
    T_map_camera[:, 0, 3] += n * _APART_M
    position_m[:, 0] += n * _APART_M
    root_parent = keyframes - 1 if n else NONE
    return state.arrays() | {
        'T_map_camera': T_map_camera,
        'parent': np.where(state.parent == NONE, root_parent, state.parent + keyframes),
        'descriptors': state.descriptors ^ mask,
        'point': np.where(state.point == NONE, NONE, state.point + points),
        'position_m': position_m,
        'reference': state.reference + keyframes,
    }
