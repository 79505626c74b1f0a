"""Masks for navigation among people: where to keep out, and where to go slowly.

The masks are for the costmap filters of Nav2 (Macenski et al., "The Marathon 2", IROS 2020).
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import FloatArray
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.scene_scheduler import Rate
from hoid_scene.tracks.object_tracker import ObjectState, TrackedObject

CLOSED = 100
"""The value of a cell in which a robot must not be; 0: it may."""
_STEP_S = 0.2  # chosen: a person walks 0.25 m in this time, less than the margin
_MAX_CELLS = 1_000_000  # chosen: of the counts; 62,500 m2
_MAX_SPAN_CELLS = 1000  # chosen: width and height of a mask; 100 m of keep-out cells


class Mask(NamedTuple):
    """Cells over the plane z = 0 of the map frame; row 0 is at the smallest y."""

    cells: NDArray[np.int8]  # (H, W) in [0, 100]
    resolution_m: float
    low: tuple[int, int]  # column and row of cell (0, 0), counted from the origin


class NavigationMasks:
    """Makes the masks from the tracks of people and objects.

    Crossings are counted in the map frame of their time; they are not saved with the map.

    Args:
        config: Parameters of the masks.
    """

    def __init__(self, config: NavigationConfig) -> None:
        self._config = config
        self._tracks: tuple[TrackedObject, ...] = ()
        self._camera_m: FloatArray = np.zeros(3)
        self._crossings: Counter[tuple[int, int]] = Counter()
        self._cells: dict[int, tuple[int, int]] = {}  # where each person is, by track
        self._due = Rate(1 / config.period_s)

    def update(
        self, tracks: tuple[TrackedObject, ...], T_map_camera: FloatArray, stamp_ns: int
    ) -> bool:
        """Replace the tracks by those after an image; return whether masks are to be published.

        Each person who is in another cell than before, or is new, is counted as a crossing of that
        cell. If the masks are to be published, they are due again one period later.

        Args:
            tracks: All confirmed tracks.
            T_map_camera: (4, 4) pose of the camera, which shows where the robot is.
            stamp_ns: Time of the image.
        """
        self._tracks, self._camera_m = tracks, T_map_camera[:3, 3]
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

    def keep_out(self) -> Mask:
        """Return the mask of the places to keep out of: CLOSED, or 0.

        The places are discs (see `_area_of`). Discs that reach 500 or more cells from the camera
        in x or y are left out. If no disc is left, the mask is one cell of 0. Cells within
        `robot_radius_m` of the camera are 0.
        """
        cell_m, camera_m = self._config.keep_out_cell_m, self._camera_m[:2]
        areas = [area for item in self._tracks if (area := self._area_of(item)) is not None]
        points_m = np.concatenate([np.empty((0, 2)), *(points for points, _ in areas)])
        radii_m = np.repeat([radius for _, radius in areas], [len(points) for points, _ in areas])
        is_near = np.abs(points_m - camera_m).max(axis=1) + radii_m < _MAX_SPAN_CELLS // 2 * cell_m
        points_m, radii_m = points_m[is_near], radii_m[is_near]
        if len(points_m) == 0:
            return Mask(np.zeros((1, 1), np.int8), cell_m, (0, 0))
        low = np.floor((points_m - radii_m[:, None]).min(axis=0) / cell_m).astype(int)
        high = np.ceil((points_m + radii_m[:, None]).max(axis=0) / cell_m).astype(int)
        width, height = high - low
        row, column = np.mgrid[:height, :width]
        centers_m = (np.stack([column, row], axis=-1) + low + 0.5) * cell_m
        gaps_m = np.linalg.norm(centers_m[:, :, None] - points_m, axis=3)  # (H, W, P)
        is_closed = (gaps_m <= radii_m).any(axis=2)
        to_robot_m = np.linalg.norm(centers_m - camera_m, axis=2)
        is_closed &= to_robot_m > self._config.robot_radius_m
        cells = np.where(is_closed, CLOSED, 0).astype(np.int8)
        return Mask(cells, cell_m, (int(low[0]), int(low[1])))

    def speed(self) -> Mask:
        """Return by how many percent to go more slowly in each cell, from the crossings.

        Cells 1000 or more cells from the lowest x or y of all crossings are left out. Without any
        crossing, the mask is one cell of 0.
        """
        cell_m = self._config.speed_cell_m
        if not self._crossings:
            return Mask(np.zeros((1, 1), np.int8), cell_m, (0, 0))
        at, counts = np.array(list(self._crossings)), np.array(list(self._crossings.values()))
        low, high = at.min(axis=0), at.max(axis=0)
        width, height = np.minimum(high - low + 1, _MAX_SPAN_CELLS)
        inside = ((at - low) < (width, height)).all(axis=1)
        shares = np.zeros((height, width))
        column, row = (at - low)[inside].T
        shares[row, column] = np.minimum(counts[inside] / self._config.busy_crossings, 1.0)
        lower = (100.0 - self._config.busy_speed_percent) * shares
        return Mask(np.rint(lower).astype(np.int8), cell_m, (int(low[0]), int(low[1])))

    def _area_of(self, item: TrackedObject) -> tuple[FloatArray, float] | None:
        """Return the centers (P, 2) and the radius of the discs to keep out of; None: no area.

        A person who stands has none: the obstacle layer has the person.
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
