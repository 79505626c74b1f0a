"""A map of a ring whose end has drifted from its beginning, for tests of loops."""

from __future__ import annotations

from functools import cache

import numpy as np

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge

from .ring_world import RingWorld, drifted, mapped, ring_poses

DRIFT = np.array([0.0, 0.002, 0.0, 0.006, 0.003, 0.0])  # per keyframe, rotation first
LAPS = 1.06
_SURE = np.diag(np.square([0.001] * 3 + [0.002] * 3))  # covariance of a loop


@cache
def _drifting() -> tuple[Atlas, IntArray, FloatArray]:
    truth = ring_poses(36, LAPS)
    atlas = Atlas(1.2, 8)
    rows = mapped(atlas, RingWorld(), truth, drifted(truth, DRIFT))
    return atlas, rows, truth


def drifting_map() -> tuple[Atlas, IntArray, FloatArray]:
    """Return a map of 1.06 laps, the rows (N,) and the true poses (N, 4, 4) of its keyframes."""
    original, rows, truth = _drifting()
    atlas = Atlas(1.2, 8)
    atlas.apply(original.changes_since(0))
    return atlas, rows, truth


def errors_m(atlas: Atlas, rows: IntArray, truth: FloatArray) -> FloatArray:
    """Return the distances (N,) of keyframes from their true poses (N, 4, 4)."""
    gap = atlas.keyframes.T_map_camera[rows, :3, 3] - truth[:, :3, 3]
    return np.asarray(np.linalg.norm(gap, axis=1))


def loop_edge(
    first_uid: int, second_uid: int, T_first_second: FloatArray, covariance: FloatArray = _SURE
) -> LoopEdge:
    """Return a closed loop between two keyframes with a (6, 6) covariance."""
    return LoopEdge(
        first_uid, second_uid, T_first_second, covariance, 50, 1.0, 'closed', 0.0, is_used=True
    )
