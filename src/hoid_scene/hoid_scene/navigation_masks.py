"""Masks for navigation among people: where to keep out, and where to go slowly.

The masks are for the costmap filters of Nav2 (Macenski et al., "The Marathon 2", IROS 2020).
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.sync import Rate
from hoid_common.values import BoolArray, FloatArray, ObjectState
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.grid.grid import GridExtent
from hoid_scene.grid.steady_grid import GridPatch, patch_of
from hoid_scene.tracks.object_track import TrackedObject

CLOSED = 100
"""The value of a cell in which a robot must not be; 0: it may."""
_STEP_S = 0.2  # chosen: a person walks 0.25 m in this time, less than the margin
_MAX_CELLS = 1_000_000  # chosen: largest number of counted cells; 62,500 m2


class Mask(NamedTuple):
    """Cells over the plane z = 0 of the map frame; row 0 is at the smallest y."""

    cells: NDArray[np.int8]  # (H, W) in [0, 100]
    # The extent of the published grid, which Nav2's costmap has too: Nav2 applies a keep-out mask
    # only where the costmap is updated and the mask has cells, and a speed filter keeps its last
    # limit where the mask has none (nav2_costmap_2d, keepout_filter.cpp and speed_filter.cpp).
    extent: GridExtent


def changed_cells(before: Mask | None, mask: Mask) -> GridPatch | None:
    """Return the smallest rectangle of changed cells; None without changes."""
    if before is None or before.extent != mask.extent:
        return patch_of(np.zeros_like(mask.cells), mask.cells)
    return patch_of(before.cells, mask.cells)


class NavigationMasks:
    """Computes the two masks from the tracks of people and objects.

    Counts of crossed cells are not moved by corrections of the map, and not saved with it.
    """

    def __init__(self, config: NavigationConfig) -> None:
        self._config = config
        self._tracks: tuple[TrackedObject, ...] = ()
        self._robot_m: FloatArray = np.zeros(2)
        self._crossings: Counter[tuple[int, int]] = Counter()
        self._cells: dict[int, tuple[int, int]] = {}  # cell of each person, by track
        self._due = Rate(1 / config.period_s)

    def update(
        self, tracks: tuple[TrackedObject, ...], T_map_base: FloatArray, stamp_ns: int
    ) -> bool:
        """Replace the tracks after an image; return whether masks are due for publication.

        Each person who is in another cell than before, or is new, is counted as a crossing of that
        cell. If the masks are to be published, they are due again one period later.
        """
        self._tracks, self._robot_m = tracks, T_map_base[:2, 3]
        before, self._cells = self._cells, {}
        for person in tracks:
            if person.state is not ObjectState.PERSON:
                continue
            x, y = np.floor(person.position_map_m[:2] / self._config.speed_cell_m).astype(int)
            cell = self._cells[person.track_id] = int(x), int(y)
            is_bounded = len(self._crossings) < _MAX_CELLS or cell in self._crossings
            if before.get(person.track_id) != cell and is_bounded:
                self._crossings[cell] += 1
        return self._due.take_due(stamp_ns)

    def keep_out(self, extent: GridExtent) -> Mask:
        """Return the mask of the places to keep out of: CLOSED, and 0 everywhere else.

        The places are discs (see `_area_of`). Cells within `footprint_radius_m` of the robot's
        base are 0, because a planner finds no way out of a closed area.
        """
        x_m, y_m = extent.centers_m()
        is_closed = np.zeros(extent.shape, np.bool_)
        for centers_m, radius_m in filter(None, map(self._area_of, self._tracks)):
            for center_m in centers_m:
                _mark_disc(is_closed, x_m, y_m, center_m, radius_m, value=True)
        _mark_disc(
            is_closed, x_m, y_m, self._robot_m, self._config.footprint_radius_m, value=False
        )
        return Mask(np.where(is_closed, CLOSED, 0).astype(np.int8), extent)

    def speed(self, extent: GridExtent) -> Mask:
        """Return the mask of the speed reduction [percent] in each cell."""
        out = np.zeros(extent.shape, np.int8)
        if self._crossings:
            at, counts = np.array(list(self._crossings)), np.array(list(self._crossings.values()))
            low, high = at.min(axis=0), at.max(axis=0)
            x, y = (
                np.floor(each_m / self._config.speed_cell_m).astype(np.int64)
                for each_m in extent.centers_m()
            )
            columns = np.flatnonzero((x >= low[0]) & (x <= high[0]))
            rows = np.flatnonzero((y >= low[1]) & (y <= high[1]))
            first, width = int(low[1]), int(high[0] - low[0]) + 1
            key = (at[:, 1] - first) * width + at[:, 0] - low[0]
            order = np.argsort(key)
            wanted = (y[rows, None] - first) * width + x[columns] - low[0]
            found = np.searchsorted(key[order], wanted).clip(max=len(key) - 1)
            is_crossed = key[order][found] == wanted
            ratio = np.minimum(counts[order][found] / self._config.busy_crossings, 1.0)
            lower = (100.0 - self._config.busy_speed_percent) * ratio * is_crossed
            out[np.ix_(rows, columns)] = np.rint(lower)
        return Mask(out, extent)

    def _area_of(self, item: TrackedObject) -> tuple[FloatArray, float] | None:
        """Return the centers (P, 2) and the radius of the discs to keep out of; None: no area.

        A standing person has no area: the obstacle layer already contains the person.
        """
        config = self._config
        at_m, velocity_mps = item.position_map_m[:2], item.velocity_map_mps[:2]
        if item.state is ObjectState.HANDLED:
            is_meant = not config.classes or item.class_name in config.classes
            radius_m = config.margin_m + float(np.linalg.norm(item.size_m[:2])) / 2
            return (at_m[None], radius_m) if is_meant else None
        is_walking = np.linalg.norm(velocity_mps) >= config.walking_mps
        if item.state is not ObjectState.PERSON or not is_walking:
            return None
        times_s = np.arange(0.0, config.horizon_s + _STEP_S / 2, _STEP_S)
        return at_m + times_s[:, None] * velocity_mps, config.margin_m


def _mark_disc(
    cells: BoolArray,
    x_m: FloatArray,
    y_m: FloatArray,
    center_m: FloatArray,
    radius_m: float,
    *,
    value: bool,
) -> None:
    """Set the cells (H, W), with centers x (W,) and y (H,), that are in a disc to `value`."""
    columns = slice(*np.searchsorted(x_m, (center_m[0] - radius_m, center_m[0] + radius_m)))
    rows = slice(*np.searchsorted(y_m, (center_m[1] - radius_m, center_m[1] + radius_m)))
    gap_x, gap_y = x_m[columns] - center_m[0], y_m[rows] - center_m[1]
    cells[rows, columns][np.hypot(gap_x, gap_y[:, None]) <= radius_m] = value
