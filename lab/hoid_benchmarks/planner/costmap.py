"""A costmap with an inflation layer, and the way to a goal in it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from hoid_common.values import BoolArray, FloatArray

CELL_M = 0.1
ROBOT_RADIUS_M = 0.2  # chosen: a small robot for rooms
# Inflation as in Nav2's default costmap (nav2_bringup, nav2_params.yaml): radius, and how fast
# the cost falls.
_INFLATION_M, _FALL_PER_M = 0.55, 3.0
_WEIGHT = 3.0  # cost of a cell beside an obstacle, relative to a free cell; chosen
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # rows and columns; each in both directions


class Costmap(NamedTuple):
    """Cells over a floor; row 0 is at y = 0, column 0 at x = 0."""

    is_blocked: BoolArray  # (H, W) the robot's center must not be there
    cost: FloatArray  # (H, W) of a way through the cell, per length; 1: free

    @classmethod
    def of(cls, is_occupied: BoolArray) -> Costmap:
        """Return the costmap of occupied cells (H, W), inflated by the radius of the robot."""
        free = np.where(is_occupied, 0, 1).astype(np.uint8)
        gap_m = CELL_M * cv2.distanceTransform(free, cv2.DIST_L2, 5).astype(np.float64)
        beyond_m = gap_m - ROBOT_RADIUS_M
        near = np.exp(-_FALL_PER_M * np.maximum(beyond_m, 0)) * (gap_m < _INFLATION_M)
        return cls(beyond_m < 0, 1 + _WEIGHT * near)

    def to_go(self, goal: tuple[int, int]) -> FloatArray:
        """Return the cost (H, W) of the way from each cell to a goal cell; inf: there is none.

        A robot that is in a blocked cell may leave it, but no way leads into one.
        """
        shape = self.cost.shape
        index = np.arange(self.cost.size).reshape(shape)
        parts = []
        for dr, dc in _STEPS:
            a = index[: shape[0] - dr, max(-dc, 0) : shape[1] - max(dc, 0)].ravel()
            b = index[dr:, max(dc, 0) : shape[1] + min(dc, 0)].ravel()
            parts += [(a, b, np.hypot(dr, dc)), (b, a, np.hypot(dr, dc))]
        # From the goal outwards: the edge (a, b) is a step of the robot from b to a.
        a, b = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        length = np.concatenate([np.full(len(part[0]), part[2]) for part in parts])
        kept = ~self.is_blocked.ravel()[a]
        a, b, length = a[kept], b[kept], length[kept]
        cost = self.cost.ravel()
        graph = coo_array((length * (cost[a] + cost[b]) / 2, (a, b)), (len(cost), len(cost)))
        return np.asarray(dijkstra(graph.tocsr(), indices=index[goal])).reshape(shape)


def cell_of(at_m: FloatArray) -> tuple[int, int]:
    """Return row and column of a position (2,)."""
    column, row = np.floor(at_m / CELL_M).astype(int).tolist()
    return row, column


def centers_m(shape: tuple[int, int]) -> FloatArray:
    """Return the centers (H, W, 2) of the cells."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    return (np.stack([column, row], -1) + 0.5) * CELL_M


def step_down(to_go: FloatArray, at_m: FloatArray, reach_m: float) -> FloatArray | None:
    """Return the position (2,) at most `reach_m` farther on the way; None: there is no way.

    Args:
        to_go: (H, W) cost of the way to the goal.
        at_m: (2,) position of the robot.
        reach_m: Length of the step.
    """
    row, column = cell_of(at_m)
    low = max(row - 1, 0), max(column - 1, 0)
    part = to_go[low[0] : row + 2, low[1] : column + 2]
    best = np.unravel_index(int(np.argmin(part)), part.shape)
    if not np.isfinite(part[best]) or part[best] >= to_go[row, column]:
        return None
    target = (np.array([low[1] + best[1], low[0] + best[0]]) + 0.5) * CELL_M
    way = target - at_m
    length = float(np.linalg.norm(way))
    return np.asarray(at_m + way * min(reach_m / max(length, 1e-9), 1.0))
