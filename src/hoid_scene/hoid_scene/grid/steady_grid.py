"""Keeps size and origin of the published grid, which rarely change while the mapped area grows."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_scene.grid.grid import UNKNOWN, Grid

# Step in which the grid grows. Chosen large, because Nav2's static layer resizes the costmap
# whenever size or origin change.
_STEP_M = 2.0


class GridPatch(NamedTuple):
    """The smallest rectangle of cells of a grid that contains all changed cells."""

    column: int  # lowest column of the rectangle in the grid
    row: int  # lowest row
    cells: NDArray[np.int8]  # (h, w) the new values


def patch_of(before: NDArray[np.int8], cells: NDArray[np.int8]) -> GridPatch | None:
    """Return the smallest rectangle with all changed cells (H, W); None without changes."""
    rows, columns = np.nonzero(before != cells)
    if len(rows) == 0:
        return None
    top, left = rows.min(), columns.min()
    changed = cells[top : rows.max() + 1, left : columns.max() + 1]
    return GridPatch(int(left), int(top), changed)


class SteadyGrid:
    """Extends each grid to cover the one before it, so that the published map never shrinks."""

    def __init__(self) -> None:
        self.last: Grid | None = None  # grid of the last call of `take_patch`

    def clear(self) -> None:
        self.last = None

    def place(self, grid: Grid) -> Grid:
        """Return the grid extended by unknown cells, so that its borders are at multiples of 2 m.

        (With a resolution that does not divide 2 m, they are at multiples of a whole number of
        cells, about 2 m.)
        The extended grid also covers the grid of the last call of `take_patch`, unless the
        resolution has changed.
        """
        block = max(1, round(_STEP_M / grid.resolution_m))
        low = np.array(grid.low) // block * block
        high = -(-(np.array(grid.low) + grid.cells.shape[::-1]) // block) * block
        last = self.last
        if last is not None and last.resolution_m == grid.resolution_m:
            low = np.minimum(low, last.low)
            high = np.maximum(high, np.array(last.low) + last.cells.shape[::-1])
        width, height = high - low
        cells = np.full((height, width), UNKNOWN, np.int8)
        column, row = np.array(grid.low) - low
        rows, columns = grid.cells.shape
        cells[row : row + rows, column : column + columns] = grid.cells
        return replace(grid, cells=cells, low=(int(low[0]), int(low[1])))

    def take_patch(self, placed: Grid) -> GridPatch | None:
        """Return the cells that have changed since the last call, and store the grid for the next.

        None is returned if no cell has changed, if size, origin or resolution have changed, and at
        the first call.
        """
        last, self.last = self.last, placed
        if last is None or last.extent != placed.extent:
            return None
        return patch_of(last.cells, placed.cells)
