"""Occupancy grid for navigation, projected from the dense map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.config.dense_config import GridConfig

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/OccupancyGrid
_STEP_M = 0.05  # between heights at which space is looked at: a seat's thickness
_CORNERS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], np.float64)
_PGM = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}  # map_server's trinary mode


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells over the floor; row 0 is at the smallest y, as in nav_msgs/OccupancyGrid."""

    cells: NDArray[np.int8]  # (H, W): FREE, OCCUPIED or UNKNOWN
    resolution_m: float
    T_map_origin: FloatArray  # (4, 4): corner of cell (0, 0), z up


class _Canvas(NamedTuple):
    """Cells from `low` to `high`, both included, counted from the floor's origin."""

    low: FloatArray  # (2,) column, row
    high: FloatArray  # (2,)
    resolution_m: float

    def counts(self, xy_m: FloatArray) -> IntArray:
        """Return (H, W) how many of (N, 2) points fall into each cell."""
        width, height = (self.high - self.low).astype(np.int64) + 1
        col, row = (np.floor(xy_m / self.resolution_m) - self.low).astype(np.int64).T
        inside = (col >= 0) & (row >= 0) & (col < width) & (row < height)
        flat = np.bincount(row[inside] * width + col[inside], minlength=width * height)
        return np.asarray(flat.reshape(height, width))


def project_grid(
    points_m: FloatArray,
    T_map_floor: FloatArray,
    config: GridConfig,
    doubtful_m: FloatArray = np.empty((0, 3)),  # noqa: B008 - is never changed
) -> Grid:
    """Return the grid of (N, 3) map points over the floor.

    A cell is occupied when enough points stand between the height limits over it. It is free when
    floor is seen and nothing else, not even one of the (M, 3) doubtful points.
    """
    T_floor_map = se3.inverse(T_map_floor)
    p, doubtful = (se3.transform(T_floor_map, x) for x in (points_m, doubtful_m))
    p, doubtful = (x[x[:, 2] < config.max_height_m] for x in (p, doubtful))
    if len(p) == 0:
        return Grid(np.empty((0, 0), np.int8), config.resolution_m, T_map_floor)
    low = np.floor((p[:, :2].min(0) - config.obstacle_margin_m) / config.resolution_m)
    high = np.floor((p[:, :2].max(0) + config.obstacle_margin_m) / config.resolution_m)
    canvas = _Canvas(low, high, config.resolution_m)
    is_tall = p[:, 2] > config.min_height_m
    tall_xy, rim = p[is_tall, :2], config.obstacle_margin_m * _CORNERS
    obstacles = np.max([canvas.counts(tall_xy + offset) for offset in rim], axis=0)
    is_doubted = canvas.counts(doubtful[doubtful[:, 2] > config.min_height_m, :2]) > 0
    cells = np.full(obstacles.shape, UNKNOWN, np.int8)
    cells[(canvas.counts(p[~is_tall, :2]) > 0) & ~is_doubted] = FREE
    cells[obstacles >= config.min_obstacle_points] = OCCUPIED
    T_floor_origin = np.eye(4)
    T_floor_origin[:2, 3] = low * config.resolution_m
    return Grid(cells, config.resolution_m, T_map_floor @ T_floor_origin)


def without_unseen(
    grid: Grid, config: GridConfig, is_clear: Callable[[FloatArray], BoolArray]
) -> Grid:
    """Return the grid without the free cells over which the space was not seen to be free.

    Floor shows under a table long before the table's top does.

    Args:
        is_clear: Tells which of (N, 3) map points are known to be free.
    """
    rows, cols = np.nonzero(grid.cells == FREE)
    heights = np.arange(config.min_height_m + _STEP_M / 2, config.clear_height_m, _STEP_M)
    if len(rows) == 0 or len(heights) == 0:
        return grid
    columns = np.empty((len(rows), len(heights), 3))
    columns[..., :2] = ((np.stack([cols, rows], axis=1) + 0.5) * grid.resolution_m)[:, None]
    columns[..., 2] = heights
    points_m = se3.transform(grid.T_map_origin, columns.reshape(-1, 3))
    unseen = ~is_clear(points_m).reshape(columns.shape[:2]).all(axis=1)
    cells = grid.cells.copy()
    cells[rows[unseen], cols[unseen]] = UNKNOWN
    return Grid(cells, grid.resolution_m, grid.T_map_origin)


def write_map_server(grid: Grid, stem: Path) -> None:
    """Write `stem`.pgm and `stem`.yaml as Nav2's map server loads them (trinary mode)."""
    image = np.full(grid.cells.shape, _PGM[UNKNOWN], np.uint8)
    for value, gray in _PGM.items():
        image[grid.cells == value] = gray
    pgm = stem.with_name(f'{stem.name}.pgm')  # a date's last part is no ending
    cv2.imwrite(str(pgm), image[::-1])  # the image's first row is the largest y
    x, y, _ = grid.T_map_origin[:3, 3]
    yaw = float(np.arctan2(grid.T_map_origin[1, 0], grid.T_map_origin[0, 0]))
    stem.with_name(f'{stem.name}.yaml').write_text(
        f'image: {pgm.name}\nmode: trinary\nresolution: {grid.resolution_m}\n'
        f'origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\n'
        'negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n'
    )
