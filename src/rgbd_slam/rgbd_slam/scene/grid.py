"""Occupancy grid for navigation, projected from the dense map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import BoolArray, ByteArray, FloatArray, IntArray
from rgbd_slam.config.dense_config import FILE_MODES, GridConfig

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/OccupancyGrid
_STEP_M = 0.05  # between heights at which space is looked at: a seat's thickness
_CORNERS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], np.float64)
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196  # as Nav2's map saver has them


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells over the floor; row 0 is at the smallest y, as in nav_msgs/OccupancyGrid.

    They lie in a level frame: x and y along the floor, z above it.
    """

    cells: NDArray[np.int8]  # (H, W): FREE, OCCUPIED or UNKNOWN
    resolution_m: float
    T_map_level: FloatArray  # (4, 4), affine where the map itself is as good as level
    low: tuple[int, int]  # column and row of cell (0, 0), counted from the level frame's origin

    @property
    def origin_m(self) -> tuple[float, float]:
        """Return x and y of the corner of cell (0, 0) in the level frame."""
        return self.low[0] * self.resolution_m, self.low[1] * self.resolution_m

    @property
    def T_map_origin(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return (4, 4) to the map from the corner of cell (0, 0)."""
        T_level_origin = np.eye(4)
        T_level_origin[:2, 3] = self.origin_m
        return self.T_map_level @ T_level_origin


class _Canvas(NamedTuple):
    """Cells from `low` to `high`, both included, counted from the origin."""

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
    T_map_level: FloatArray,
    config: GridConfig,
    doubtful_m: FloatArray = np.empty((0, 3)),  # noqa: B008 - is never changed
) -> Grid:
    """Return the grid of (N, 3) map points over the floor.

    A cell is occupied when enough points stand between the height limits over it. It is free when
    floor is seen and nothing else, not even one of the (M, 3) doubtful points. In the level frame
    the floor is at z = 0.
    """
    T_level_map = np.asarray(np.linalg.inv(T_map_level), np.float64)
    p, doubtful = (se3.transform(T_level_map, x) for x in (points_m, doubtful_m))
    p, doubtful = (x[x[:, 2] < config.max_height_m] for x in (p, doubtful))
    if len(p) == 0:
        return Grid(np.empty((0, 0), np.int8), config.resolution_m, T_map_level, (0, 0))
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
    return Grid(cells, config.resolution_m, T_map_level, (int(low[0]), int(low[1])))


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
    return replace(grid, cells=cells)


def write_map_server(grid: Grid, stem: Path, mode: str = FILE_MODES[0]) -> None:
    """Write `stem`.yaml and its picture as Nav2's map server loads them in a mode of its."""
    image, ending = _PICTURES[mode](grid.cells[::-1])  # the first row is the largest y
    picture = stem.with_name(stem.name + ending)  # a date's last part is no ending
    cv2.imwrite(str(picture), image)
    x, y = grid.origin_m
    stem.with_name(f'{stem.name}.yaml').write_text(
        f'image: {picture.name}\nmode: {mode}\nresolution: {grid.resolution_m}\n'
        f'origin: [{x:.6f}, {y:.6f}, 0.000000]\n'
        f'negate: 0\noccupied_thresh: {_OCCUPIED_ABOVE}\nfree_thresh: {_FREE_BELOW}\n'
    )


def _trinary(cells: NDArray[np.int8]) -> tuple[ByteArray, str]:
    """Return three grays; what is unknown counts as 50 / 255 = 0.19608, just not free."""
    return np.select([cells == FREE, cells == OCCUPIED], [254, 0], 205).astype(np.uint8), '.pgm'


def _scale(cells: NDArray[np.int8]) -> tuple[ByteArray, str]:
    """Return grays as bright as cells are free; what is unknown is transparent."""
    gray = np.where(cells == FREE, 255, 0)
    opaque = np.where(cells == UNKNOWN, 0, 255)
    return np.stack([gray, gray, gray, opaque], axis=-1).astype(np.uint8), '.png'


def _raw(cells: NDArray[np.int8]) -> tuple[ByteArray, str]:
    """Return the numbers themselves; -1 is 255."""
    return cells.astype(np.uint8), '.pgm'


_PICTURES = dict(zip(FILE_MODES, (_trinary, _scale, _raw), strict=True))
