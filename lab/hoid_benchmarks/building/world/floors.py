"""The geometry of a building: cells that are boxes, and the openings between them.

Corridors run on a grid, and every block between them holds four rooms with a door each. Cells are
convex, so that nothing inside a cell hides anything else, and a point of another cell is visible
only through the openings on the way to it. World coordinates are in m, z up; the ground of floor f
is at z = f * STOREY_M.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray

CEILING_M = 2.8
STOREY_M = 3.2
CORRIDOR_HALF_M = 1.0
STAIRS_M = 10.0  # length of a staircase
_DOOR_HALF_M = 0.5
_DOOR_TOP_M = 2.1
_ON_BORDER_M = 1e-6


class CellKind(IntEnum):
    """The kinds of cells."""

    JUNCTION = 0
    CORRIDOR_X = 1  # along x, from its junction to the next one
    CORRIDOR_Y = 2
    ROOM = 3
    STAIRS = 4  # from its junction on this floor to the same junction on the next one


class CellKey(NamedTuple):
    """Identifies a cell by its position in the grid."""

    kind: CellKind
    floor: int
    column: int
    row: int
    east: int = 0  # 1: the eastern ones of the four rooms of a block
    north: int = 0  # 1: the northern ones, whose doors are in their northern walls


@dataclass(frozen=True)
class Opening:
    """A rectangle in a vertical plane through which one cell is seen from the next."""

    axis: int  # 0: the plane x = at_m; 1: y = at_m
    at_m: float
    low_m: tuple[float, float]  # along the other horizontal axis, and z
    high_m: tuple[float, float]

    def contains(self, points_m: Float32Array) -> BoolArray:
        """Return the (N,) mask of points (N, 3) in the opening's plane that are inside it."""
        across, z = points_m[:, 1 - self.axis], points_m[:, 2]
        inside: BoolArray = (across > self.low_m[0]) & (across < self.high_m[0])
        inside &= (z > self.low_m[1]) & (z < self.high_m[1])
        return inside

    def passes(self, eye_m: Float32Array, points_m: Float32Array) -> BoolArray:
        """Return the (N,) mask of points (N, 3) seen from `eye_m` through the opening."""
        ray = points_m - eye_m
        with np.errstate(divide='ignore', invalid='ignore'):
            t = (self.at_m - eye_m[self.axis]) / ray[:, self.axis]
            crossing = eye_m + t[:, None] * ray
        passes: BoolArray = (t > -_ON_BORDER_M) & (t < 1) & self.contains(crossing)
        return passes


@dataclass(eq=False)
class Cell:
    """A box of space with the openings to its neighbors."""

    key: CellKey
    low_m: FloatArray  # (3,)
    high_m: FloatArray  # (3,)
    # Cells with the same numbers look almost alike. None: the cell looks like no other.
    template: tuple[int, ...] | None = None
    # Landmarks of its own that a cell with a template has in addition, per landmark of this.
    own_share: float = 0.15
    period_m: float | None = None  # distance after which a corridor along x looks the same again
    neighbors: list[tuple[CellKey, Opening]] = field(default_factory=list)

    @property
    def center_m(self) -> FloatArray:
        """Return the center (3,)."""
        return np.asarray((self.low_m + self.high_m) / 2)

    def contains(self, point_m: FloatArray) -> bool:
        """Return whether a point (3,) is inside the cell or on its border."""
        inside = (point_m >= self.low_m - _ON_BORDER_M) & (point_m <= self.high_m + _ON_BORDER_M)
        return bool(inside.all())


class Building:
    """The cells of all floors.

    Args:
        columns: Number of blocks along x.
        rows: Number of blocks along y.
        floors: Number of floors. Staircase f is west of junction (0, f).
        block_m: Distance of junctions along x and y.
        seed: Determines which rooms look alike, and the landmarks.
        alike_share: Share of the rooms that look like others.
        num_templates: Number of different looks of those rooms.
        floors_alike: Landmarks of its own that each floor has in addition to those that all floors
            have in common, per common landmark; None: the floors have nothing in common.
        period_m: Distance after which corridors along x look the same again; None: nowhere.
    """

    def __init__(
        self,
        columns: int = 10,
        rows: int = 10,
        floors: int = 1,
        *,
        block_m: tuple[float, float] = (18.0, 12.0),
        seed: int = 0,
        alike_share: float = 0.3,
        num_templates: int = 2,
        floors_alike: float | None = None,
        period_m: float | None = None,
    ) -> None:
        self.columns, self.rows, self.floors = columns, rows, floors
        self.block_m = block_m
        self.seed = seed
        self.cells: dict[CellKey, Cell] = {}
        rng = np.random.default_rng(seed + 1)
        for floor in range(floors):
            self._add_corridors(floor)
            self._add_rooms(floor, alike_share, num_templates, rng)
        for cell in self.cells.values():
            if floors_alike is not None:
                cell.template = tuple(cell.key._replace(floor=0))
                cell.own_share = floors_alike
            if cell.key.kind is CellKind.CORRIDOR_X:
                cell.period_m = period_m
        for floor in range(floors - 1):
            self._add_stairs(floor)

    def junction_m(self, floor: int, column: int, row: int) -> FloatArray:
        """Return the point (3,) on the ground in the middle of a junction."""
        return np.array([column * self.block_m[0], row * self.block_m[1], floor * STOREY_M])

    def cell_at(self, point_m: FloatArray, last: Cell | None = None) -> Cell:
        """Return the cell that contains a point (3,); `last` and its neighbors are tried first.

        Raises:
            ValueError: No cell contains the point.
        """
        near = [] if last is None else [last, *(self.cells[key] for key, _ in last.neighbors)]
        for cell in (*near, *self.cells.values()):
            if cell.contains(point_m):
                return cell
        raise ValueError(f'no cell contains the point {point_m}')

    def _add_corridors(self, floor: int) -> None:
        half, (x_m, y_m) = CORRIDOR_HALF_M, self.block_m
        for c in range(self.columns + 1):
            for r in range(self.rows + 1):
                x, y = c * x_m, r * y_m
                junction = CellKey(CellKind.JUNCTION, floor, c, r)
                self._add(junction, (x - half, y - half), (x + half, y + half))
                if c < self.columns:
                    key = CellKey(CellKind.CORRIDOR_X, floor, c, r)
                    self._add(key, (x + half, y - half), (x + x_m - half, y + half))
                if r < self.rows:
                    key = CellKey(CellKind.CORRIDOR_Y, floor, c, r)
                    self._add(key, (x - half, y + half), (x + half, y + y_m - half))
        for key in [key for key in self.cells if key.floor == floor]:
            if key.kind is CellKind.CORRIDOR_X:
                self._open_ends(key, 0, key._replace(column=key.column + 1))
            elif key.kind is CellKind.CORRIDOR_Y:
                self._open_ends(key, 1, key._replace(row=key.row + 1))

    def _open_ends(self, key: CellKey, axis: int, after: CellKey) -> None:
        """Open a corridor to the junctions at both of its ends."""
        cell, across = self.cells[key], 1 - axis
        for end, at_m in ((key, cell.low_m[axis]), (after, cell.high_m[axis])):
            low_m, high_m = cell.low_m[[across, 2]].tolist(), cell.high_m[[across, 2]].tolist()
            opening = Opening(axis, float(at_m), tuple(low_m), tuple(high_m))
            self._connect(key, end._replace(kind=CellKind.JUNCTION), opening)

    def _add_rooms(
        self, floor: int, alike_share: float, num_templates: int, rng: np.random.Generator
    ) -> None:
        half, ground_m = CORRIDOR_HALF_M, floor * STOREY_M
        width_m, depth_m = (np.array(self.block_m) - 2 * half) / 2
        for c, r, east, north in np.ndindex(self.columns, self.rows, 2, 2):
            key = CellKey(CellKind.ROOM, floor, c, r, east, north)
            x = c * self.block_m[0] + half + east * width_m
            y = r * self.block_m[1] + half + north * depth_m
            cell = self._add(key, (x, y), (x + width_m, y + depth_m))
            if rng.random() < alike_share:
                cell.template = (int(rng.integers(num_templates)),)
            middle, door_y = float(cell.center_m[0]), (cell.low_m, cell.high_m)[north][1]
            door = Opening(
                1,
                float(door_y),
                (middle - _DOOR_HALF_M, ground_m),
                (middle + _DOOR_HALF_M, ground_m + _DOOR_TOP_M),
            )
            self._connect(key, CellKey(CellKind.CORRIDOR_X, floor, c, r + north), door)

    def _add_stairs(self, floor: int) -> None:
        """Add a staircase two floors high west of junction (0, floor)."""
        half = CORRIDOR_HALF_M
        key = CellKey(CellKind.STAIRS, floor, 0, floor)
        y = floor * self.block_m[1]
        cell = self._add(key, (-half - STAIRS_M, y - half), (-half, y + half))
        cell.high_m[2] += STOREY_M
        for n in (floor, floor + 1):
            low_m, high_m = (y - half, n * STOREY_M), (y + half, n * STOREY_M + CEILING_M)
            opening = Opening(0, -half, low_m, high_m)
            self._connect(key, CellKey(CellKind.JUNCTION, n, 0, floor), opening)

    def _add(self, key: CellKey, low_m: tuple[float, float], high_m: tuple[float, float]) -> Cell:
        ground_m = key.floor * STOREY_M
        cell = Cell(key, np.array([*low_m, ground_m]), np.array([*high_m, ground_m + CEILING_M]))
        self.cells[key] = cell
        return cell

    def _connect(self, a: CellKey, b: CellKey, opening: Opening) -> None:
        self.cells[a].neighbors.append((b, opening))
        self.cells[b].neighbors.append((a, opening))
