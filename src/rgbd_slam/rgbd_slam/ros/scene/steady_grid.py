"""A grid whose size and origin stay while the room grows: they change in steps only."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_slam.scene.grid import UNKNOWN, Grid

_STEP_M = 2.0


class GridPatch(NamedTuple):
    """The rectangle of cells that are others than before."""

    column: int
    row: int
    cells: NDArray[np.int8]  # (h, w)


class SteadyGrid:
    """Lays grids into a larger one, which never shrinks while the resolution is the same."""

    def __init__(self) -> None:
        self._last: Grid | None = None

    def clear(self) -> None:
        """Begin with another map."""
        self._last = None

    def place(self, grid: Grid) -> Grid:
        """Return the grid with a margin of unknown cells up to the next steps."""
        block = max(1, round(_STEP_M / grid.resolution_m))
        low = np.array(grid.low) // block * block
        high = -(-(np.array(grid.low) + grid.cells.shape[::-1]) // block) * block
        last = self._last
        if last is not None and last.resolution_m == grid.resolution_m:
            low = np.minimum(low, last.low)
            high = np.maximum(high, np.array(last.low) + last.cells.shape[::-1])
        width, height = high - low
        cells = np.full((height, width), UNKNOWN, np.int8)
        column, row = np.array(grid.low) - low
        rows, columns = grid.cells.shape
        cells[row : row + rows, column : column + columns] = grid.cells
        return replace(grid, cells=cells, low=(int(low[0]), int(low[1])))

    def show(self, placed: Grid) -> GridPatch | None:
        """Take a placed grid as the one that is known; return what changed, if only cells did."""
        last, self._last = self._last, placed
        if last is None or (last.low, last.resolution_m, last.cells.shape) != (
            placed.low, placed.resolution_m, placed.cells.shape,
        ):  # fmt: skip
            return None
        rows, columns = np.nonzero(last.cells != placed.cells)
        if len(rows) == 0:
            return None
        top, left = rows.min(), columns.min()
        cells = placed.cells[top : rows.max() + 1, left : columns.max() + 1]
        return GridPatch(int(left), int(top), cells)
