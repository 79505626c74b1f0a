"""Determines which space above the floor the images have seen to be free.

The floor under a table may be seen long before the top of the table. Therefore a cell of the grid
is free only if all space above it was seen to be free, up to a limit of height. Each column of a
submap keeps one bit per step of height (`Submap.free_above`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import Float32Array
from hoid_scene.dense.depth_view import DepthCamera, DepthView
from hoid_scene.dense.submap import Submap, transform
from hoid_scene.grid.floor import Floor

_STEP_M = 0.05  # step of height; chosen: the thickness of a seat
# Heights above the floor [m] of the centers of the 16 steps of height; each step has one bit.
_HEIGHTS_M = (_STEP_M * (np.arange(16) + 0.5)).astype(np.float32)
_ALL_FREE = np.uint16(0xFFFF)
_FLOOR_BAND_M = 0.1  # chosen: voxels this near to the floor count as floor
_FREE_MARGIN_M = 0.03  # a point is free if the surface behind it is this much farther; not tuned

Bits = NDArray[np.uint16]


def required_bits(low_m: float, high_m: float) -> np.uint16:
    """Return the bits of the height steps whose centers lie in a range above the floor [m]."""
    steps = np.flatnonzero((low_m < _HEIGHTS_M) & (high_m > _HEIGHTS_M))
    return np.uint16(np.sum(1 << steps))


def mark_free_space(
    submaps: Iterable[Submap],
    floor: Floor,
    floor_m: Mapping[Submap, float],
    camera: DepthCamera,
    read: Callable[[int], DepthView | None],
) -> None:
    """Set the bits of the height steps that new images have seen to be free.

    A stored image is new for a submap if the submap was in its view, and if its slot is not in
    `Submap.marked`. Each call adds the slots of all such images to `marked`.

    Args:
        floor_m: Height [m] of the floor of each submap above this plane.
        read: Returns a stored image by its slot; None if it has been removed.
    """
    waiting: dict[int, list[Submap]] = {}
    for submap in submaps:
        if _may_show_floor(submap, floor, floor_m[submap]):
            for slot in submap.poses.keys() - submap.marked:
                waiting.setdefault(slot, []).append(submap)
        submap.marked = set(submap.poses)
    columns = {s: _Columns(s, floor, floor_m[s]) for part in waiting.values() for s in part}
    for slot, part in sorted(waiting.items(), reverse=True):  # the newest images see most
        open_parts = [columns[submap] for submap in part if columns[submap].count_open()]
        view = read(slot) if open_parts else None
        if view is not None:
            points = [column.points_m(slot) for column in open_parts]
            seen = camera.compare(np.concatenate(points).reshape(-1, 3), view)
            is_free = np.zeros(16 * sum(map(len, points)), np.bool_)
            is_free[seen.rows[seen.gap_m > _FREE_MARGIN_M + seen.noise_m]] = True
            bits = np.packbits(is_free, bitorder='little').view(np.uint16)
            for column in open_parts:
                bits = column.take(bits)


def _may_show_floor(submap: Submap, floor: Floor, floor_m: float) -> bool:
    """Return whether the floor, `floor_m` above the plane, passes through a submap or near it."""
    up, origin_m = floor.T_map_floor[:3, 2], floor.T_map_floor[:3, 3]
    above_m = (submap.center_map_m - origin_m) @ up - floor_m
    reach_m = submap.radius_m / np.sqrt(3) * np.abs(submap.T_map_submap[:3, :3].T @ up).sum()
    return bool(abs(above_m) < reach_m + _FLOOR_BAND_M)


class _Columns:
    """The vertical columns of space above those voxels of one submap that show the floor."""

    def __init__(self, submap: Submap, floor: Floor, floor_m: float) -> None:
        self._submap = submap
        up, origin = floor.T_map_floor[:3, 2], floor.T_map_floor[:3, 3]
        T = submap.T_map_submap
        up_submap, offset_m = T[:3, :3].T @ up, float((T[:3, 3] - origin) @ up) - floor_m
        above_m = submap.points_m() @ up_submap.astype(np.float32) + np.float32(offset_m)
        is_floor = np.abs(above_m) < _FLOOR_BAND_M
        self._columns = np.unique(submap.columns()[is_floor])
        xy = submap.column_centers_m(self._columns)
        z = -(xy @ up_submap[:2] + offset_m) / up_submap[2]
        base = np.concatenate([xy, z[:, None]], axis=1)
        self._points_m = (base[:, None] + _HEIGHTS_M[:, None] * up_submap).astype(np.float32)

    @property
    def _bits(self) -> Bits:
        return np.asarray(self._submap.free_above.reshape(-1)[self._columns])

    def count_open(self) -> int:
        return int(np.count_nonzero(self._bits != _ALL_FREE))

    def points_m(self, slot: int) -> Float32Array:
        """Return the step centers (N, 16, 3), camera frame, of the N columns not all free yet."""
        T_camera_submap = se3.inverse(self._submap.poses[slot])
        points_m = self._points_m[self._bits != _ALL_FREE]
        return transform(T_camera_submap, points_m.reshape(-1, 3)).reshape(-1, 16, 3)

    def take(self, bits: Bits) -> Bits:
        """Add the first N of `bits` to the N columns not all free yet; return the rest."""
        is_open = self._bits != _ALL_FREE
        count = int(np.count_nonzero(is_open))
        new = self._bits
        new[is_open] |= bits[:count]
        if (new != self._bits).any():
            self._submap.free_above.reshape(-1)[self._columns] = new
            self._submap.revision += 1
        return bits[count:]
