"""The occupancy grid for navigation, a projection of the dense map onto the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import InputError
from hoid_common.values import BoolArray, FloatArray
from hoid_scene.config.dense_config import GridConfig
from hoid_scene.grid.free_space import required_bits

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # nav_msgs/OccupancyGrid
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196  # the defaults of Nav2's map saver


class GridExtent(NamedTuple):
    """Position, size and resolution of a grid in the x-y plane of its frame."""

    low: tuple[int, int]  # column and row of cell (0, 0), counted from the origin of the frame
    shape: tuple[int, int]  # numbers of rows and columns
    resolution_m: float

    def centers_m(self) -> tuple[FloatArray, FloatArray]:
        """Return x (W,) [m] of the column centers and y (H,) [m] of the row centers."""
        rows, columns = (np.arange(count, dtype=np.float64) + 0.5 for count in self.shape)
        x_m = np.asarray((self.low[0] + columns) * self.resolution_m)
        return x_m, np.asarray((self.low[1] + rows) * self.resolution_m)


@dataclass(frozen=True, eq=False)
class Grid:
    """An occupancy grid over the floor; row 0 is at the smallest y, as in nav_msgs/OccupancyGrid.

    The x and y of its level frame are along the floor or those of the map frame; z is the height
    above the floor.
    """

    cells: NDArray[np.int8]  # (H, W): FREE, OCCUPIED or UNKNOWN
    resolution_m: float
    # (4, 4) transform from the level frame; affine, not rigid, if that frame has the map's x, y.
    T_map_level: FloatArray
    low: tuple[int, int]  # x and y of the corner of cell (0, 0) in the level frame, in cells

    @property
    def extent(self) -> GridExtent:
        height, width = self.cells.shape
        return GridExtent(self.low, (height, width), self.resolution_m)

    @property
    def origin_m(self) -> tuple[float, float]:
        """Return x and y [m] of the outer corner of cell (0, 0) in the level frame."""
        return self.low[0] * self.resolution_m, self.low[1] * self.resolution_m

    @property
    def T_map_origin(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return the transform (4, 4) to the map frame from the outer corner of cell (0, 0)."""
        T_level_origin = np.eye(4)
        T_level_origin[:2, 3] = self.origin_m
        return self.T_map_level @ T_level_origin


class SubmapCells(NamedTuple):
    """The M cells that the voxels of one submap fall into, each once."""

    column_row: NDArray[np.int64]  # (M, 2), counted from the level frame's origin
    kinds: NDArray[np.uint8]  # (M,) flags of the kinds of voxels in the cell, see below
    free_above: NDArray[np.uint16]  # (M,) bit k: the k-th 5 cm above the floor are known free


# Flags of a cell: it has a voxel of the floor, a voxel above the floor, and a voxel above the
# floor on which too few images agree.
_FLOOR, _OBSTACLE, _DOUBT = 1, 2, 4


def cells_of(
    points_m: NDArray[np.floating],
    is_shown: BoolArray,
    free_above: NDArray[np.uint16],
    config: GridConfig,
) -> SubmapCells:
    """Return the cells that the usable voxels (N, 3), level frame, of one submap fall into.

    Voxels up to `min_height_m`, also those below z = 0, are voxels of the floor; they are usable
    if enough images agree. Voxels from `max_height_m` on are not usable.

    Args:
        is_shown: (N,) whether enough images agree on a voxel.
        free_above: (N,) bits of the height steps above a voxel that are known to be free; only
            those of voxels of the floor are used.
    """
    height_m = points_m[:, 2]
    is_tall = height_m > config.min_height_m
    kinds = np.select([is_shown & ~is_tall, is_shown, is_tall], [_FLOOR, _OBSTACLE, _DOUBT], 0)
    used = (kinds > 0) & (height_m < config.max_height_m)
    cells = np.floor(points_m[used, :2] / config.resolution_m).astype(np.int64)
    if len(cells) == 0:
        return SubmapCells(cells, np.empty(0, np.uint8), np.empty(0, np.uint16))
    order = np.lexsort(cells.T)
    cells, kinds = cells[order], kinds[used][order].astype(np.uint8)
    free = np.where(kinds == _FLOOR, free_above[used][order], np.uint16(0))
    first = np.flatnonzero(np.r_[True, (cells[1:] != cells[:-1]).any(axis=1)])
    return SubmapCells(
        cells[first], np.bitwise_or.reduceat(kinds, first), np.bitwise_or.reduceat(free, first)
    )


def compose_grid(
    parts: Sequence[SubmapCells], T_map_level: FloatArray, config: GridConfig
) -> Grid:
    """Return the grid that joins the cells of all submaps, of which there must be at least one.

    A cell is occupied if it has a voxel between `min_height_m` and `max_height_m` on which enough
    images agree. It is free if it has a voxel of the floor on which enough images agree, no voxel
    between these heights, not even an unconfirmed one, and if the space above it is known to be
    free from `min_height_m` to `clear_height_m`. Other cells are unknown.

    The grid is the smallest that contains all cells with a voxel on which enough images agree. It
    is of size (0, 0) if there are none.
    """
    cells, kinds, free = (np.concatenate(column) for column in zip(*parts, strict=True))
    is_known = (kinds & (_FLOOR | _OBSTACLE)) > 0
    if not is_known.any():
        return Grid(np.empty((0, 0), np.int8), config.resolution_m, T_map_level, (0, 0))
    low, high = cells[is_known].min(axis=0), cells[is_known].max(axis=0)
    inside = ((cells >= low) & (cells <= high)).all(axis=1)
    width, height = high - low + 1
    at = ((cells - low)[inside] @ np.array([1, width])).astype(np.int64)
    all_kinds, all_free = np.zeros(height * width, np.uint8), np.zeros(height * width, np.uint16)
    np.bitwise_or.at(all_kinds, at, kinds[inside])
    np.bitwise_or.at(all_free, at, free[inside])
    required = required_bits(config.min_height_m, config.clear_height_m)
    is_free = (all_kinds == _FLOOR) & (all_free & required == required)
    is_occupied = (all_kinds & _OBSTACLE) > 0
    out = np.select([is_occupied, is_free], [OCCUPIED, FREE], UNKNOWN).astype(np.int8)
    place = int(low[0]), int(low[1])
    return Grid(out.reshape(height, width), config.resolution_m, T_map_level, place)


def write_map_server(grid: Grid, stem: Path) -> None:
    """Write a grid as `stem`.yaml and `stem`.pgm for the `trinary` mode of Nav2's map server.

    The origin in the file is the corner of cell (0, 0) in the level frame, with height and yaw 0.
    InputError if the grid has no cell. OSError if a file cannot be written.
    """
    if grid.cells.size == 0:
        raise InputError('no cell of the grid is confirmed yet: show the camera the place longer')
    cells = grid.cells[::-1]  # the image's first row is at the largest y
    # The value 205 is an occupancy of 1 - 205 / 255 = 0.196, which is just not below the limit of
    # free cells.
    gray = np.select([cells == FREE, cells == OCCUPIED], [254, 0], 205).astype(np.uint8)
    image = stem.with_name(f'{stem.name}.pgm')  # not with_suffix: a date contains dots
    _, encoded = cv2.imencode(image.suffix, gray)
    image.write_bytes(encoded.tobytes())
    x, y = grid.origin_m
    stem.with_name(f'{stem.name}.yaml').write_text(
        f'image: {image.name}\nmode: trinary\nresolution: {grid.resolution_m}\n'
        f'origin: [{x:.6f}, {y:.6f}, 0.000000]\n'
        f'negate: 0\noccupied_thresh: {_OCCUPIED_ABOVE}\nfree_thresh: {_FREE_BELOW}\n'
    )
