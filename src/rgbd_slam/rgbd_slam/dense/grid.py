"""Occupancy grid for navigation, projected from the dense map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.dense.config import GridConfig

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/OccupancyGrid
_CORNERS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], np.float64)
_PGM = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}  # map_server's trinary mode


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells over the floor; row 0 is at the smallest y, as in nav_msgs/OccupancyGrid."""

    cells: NDArray[np.int8]  # (H, W): FREE, OCCUPIED or UNKNOWN
    resolution_m: float
    T_map_origin: FloatArray  # (4, 4): corner of cell (0, 0), z up


def project_grid(points_m: FloatArray, T_map_floor: FloatArray, config: GridConfig) -> Grid:
    """Return the grid of (N, 3) map points over the floor.

    A cell is occupied when enough points stand between the height limits over it, free when
    only floor is seen.
    """
    p = se3.transform(se3.inverse(T_map_floor), points_m)
    p = p[p[:, 2] < config.max_height_m]
    if len(p) == 0:
        return Grid(np.empty((0, 0), np.int8), config.resolution_m, T_map_floor)
    is_tall = p[:, 2] > config.min_height_m
    low = np.floor((p[:, :2].min(0) - config.obstacle_margin_m) / config.resolution_m)
    high = np.floor((p[:, :2].max(0) + config.obstacle_margin_m) / config.resolution_m)
    width, height = (high - low).astype(np.int64) + 1
    counts = np.zeros((2, height, width), np.int64)
    np.add.at(counts[0], _cells(p[~is_tall, :2], low, config.resolution_m), 1)
    margin = config.obstacle_margin_m * _CORNERS if config.obstacle_margin_m else _CORNERS[:1] * 0
    for offset in margin:
        here = np.zeros_like(counts[1])
        np.add.at(here, _cells(p[is_tall, :2] + offset, low, config.resolution_m), 1)
        counts[1] = np.maximum(counts[1], here)
    cells = np.full((height, width), UNKNOWN, np.int8)
    cells[counts[0] > 0] = FREE
    cells[counts[1] >= config.min_obstacle_points] = OCCUPIED
    T_floor_origin = np.eye(4)
    T_floor_origin[:2, 3] = low * config.resolution_m
    return Grid(cells, config.resolution_m, T_map_floor @ T_floor_origin)


def _cells(xy_m: FloatArray, low: FloatArray, resolution_m: float) -> tuple[IntArray, IntArray]:
    """Return rows and columns of (N, 2) points, counted from cell `low`."""
    cell = (np.floor(xy_m / resolution_m) - low).astype(np.int64)
    return cell[:, 1], cell[:, 0]


def write_map_server(grid: Grid, stem: Path) -> None:
    """Write `stem`.pgm and `stem`.yaml as Nav2's map server loads them (trinary mode)."""
    image = np.full(grid.cells.shape, _PGM[UNKNOWN], np.uint8)
    for value, gray in _PGM.items():
        image[grid.cells == value] = gray
    pgm = stem.with_suffix('.pgm')
    cv2.imwrite(str(pgm), image[::-1])  # the image's first row is the largest y
    x, y, _ = grid.T_map_origin[:3, 3]
    yaw = float(np.arctan2(grid.T_map_origin[1, 0], grid.T_map_origin[0, 0]))
    stem.with_suffix('.yaml').write_text(
        f'image: {pgm.name}\nmode: trinary\nresolution: {grid.resolution_m}\n'
        f'origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\n'
        'negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n'
    )
