"""The occupancy grid for navigation, a projection of the dense map onto the floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.config.dense_config import GridConfig

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/OccupancyGrid
_STEP_M = 0.05  # chosen: vertical step of the test for free space, the thickness of a seat
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196  # the defaults of Nav2's map saver


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells over the floor; row 0 is at the smallest y, as in nav_msgs/OccupancyGrid.

    The cells are in the level frame: x and y along the floor, z the height above it.
    """

    cells: NDArray[np.int8]  # (H, W): FREE, OCCUPIED or UNKNOWN
    resolution_m: float
    T_map_level: FloatArray  # (4, 4); affine if the level frame keeps the map's x and y
    low: tuple[int, int]  # column and row of cell (0, 0) from the level frame's origin

    @property
    def origin_m(self) -> tuple[float, float]:
        """Return x and y of the outer corner of cell (0, 0) in the level frame."""
        return self.low[0] * self.resolution_m, self.low[1] * self.resolution_m

    @property
    def T_map_origin(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return the pose (4, 4) of the outer corner of cell (0, 0) in the map frame."""
        T_level_origin = np.eye(4)
        T_level_origin[:2, 3] = self.origin_m
        return self.T_map_level @ T_level_origin


class _Canvas(NamedTuple):
    """A range of cells from `low` to `high`, inclusive, counted from the level frame's origin."""

    low: FloatArray  # (2,) column, row
    high: FloatArray  # (2,)
    resolution_m: float

    def contains(self, xy_m: FloatArray) -> BoolArray:
        """Return the (H, W) mask of the cells that contain any of the points (N, 2)."""
        width, height = (self.high - self.low).astype(np.int64) + 1
        col, row = (np.floor(xy_m / self.resolution_m) - self.low).astype(np.int64).T
        inside = (col >= 0) & (row >= 0) & (col < width) & (row < height)
        cells = np.zeros((height, width), np.bool_)
        cells[row[inside], col[inside]] = True
        return cells


def project_grid(
    points_m: FloatArray,
    T_map_level: FloatArray,
    config: GridConfig,
    unconfirmed_m: FloatArray = np.empty((0, 3)),  # noqa: B008 - is never changed
) -> Grid:
    """Return the grid of points (N, 3) in the map frame.

    A cell is occupied if a point is above it, between the limits of height. It is free if only
    points of the floor are there, and not even one unconfirmed point (M, 3) above it.
    """
    T_level_map = np.asarray(np.linalg.inv(T_map_level), np.float64)
    p, unconfirmed = (se3.transform(T_level_map, x) for x in (points_m, unconfirmed_m))
    p, unconfirmed = (x[x[:, 2] < config.max_height_m] for x in (p, unconfirmed))
    if len(p) == 0:
        return Grid(np.empty((0, 0), np.int8), config.resolution_m, T_map_level, (0, 0))
    low = np.floor(p[:, :2].min(0) / config.resolution_m)
    high = np.floor(p[:, :2].max(0) / config.resolution_m)
    canvas = _Canvas(low, high, config.resolution_m)
    is_tall = p[:, 2] > config.min_height_m
    is_occupied = canvas.contains(p[is_tall, :2])
    is_blocked = canvas.contains(unconfirmed[unconfirmed[:, 2] > config.min_height_m, :2])
    cells = np.full(is_occupied.shape, UNKNOWN, np.int8)
    cells[canvas.contains(p[~is_tall, :2]) & ~is_blocked] = FREE
    cells[is_occupied] = OCCUPIED
    return Grid(cells, config.resolution_m, T_map_level, (int(low[0]), int(low[1])))


def require_free_space(
    grid: Grid, config: GridConfig, is_free: Callable[[FloatArray], BoolArray]
) -> Grid:
    """Return the grid with free cells set to unknown where the space above is not known as free.

    The floor under a table is seen long before the top of the table.

    Args:
        grid: The grid.
        config: Gives the height up to which the space must be free.
        is_free: Returns the (N,) mask of the map points (N, 3) that are in free space.
    """
    rows, cols = np.nonzero(grid.cells == FREE)
    heights = np.arange(config.min_height_m + _STEP_M / 2, config.clear_height_m, _STEP_M)
    if len(rows) == 0 or len(heights) == 0:
        return grid
    columns = np.empty((len(rows), len(heights), 3))
    columns[..., :2] = ((np.stack([cols, rows], axis=1) + 0.5) * grid.resolution_m)[:, None]
    columns[..., 2] = heights
    points_m = se3.transform(grid.T_map_origin, columns.reshape(-1, 3))
    unseen = ~is_free(points_m).reshape(columns.shape[:2]).all(axis=1)
    cells = grid.cells.copy()
    cells[rows[unseen], cols[unseen]] = UNKNOWN
    return replace(grid, cells=cells)


def write_map_server(grid: Grid, stem: Path) -> None:
    """Write `stem`.yaml and `stem`.pgm for Nav2's map server, in its mode `trinary`."""
    cells = grid.cells[::-1]  # the image's first row is at the largest y
    # Unknown is 1 - 205 / 255 = 0.196, just not free.
    gray = np.select([cells == FREE, cells == OCCUPIED], [254, 0], 205).astype(np.uint8)
    image = stem.with_name(f'{stem.name}.pgm')  # not with_suffix: a date contains dots
    cv2.imwrite(str(image), gray)
    x, y = grid.origin_m
    stem.with_name(f'{stem.name}.yaml').write_text(
        f'image: {image.name}\nmode: trinary\nresolution: {grid.resolution_m}\n'
        f'origin: [{x:.6f}, {y:.6f}, 0.000000]\n'
        f'negate: 0\noccupied_thresh: {_OCCUPIED_ABOVE}\nfree_thresh: {_FREE_BELOW}\n'
    )
