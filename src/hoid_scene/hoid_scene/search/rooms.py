"""The rooms of the scene: the space between walls, divided at passages as narrow as doors.

Rooms are the parts that remain of the open space if a disk that does not fit through a door rolls
in it (distance transform), grown back until they meet (watershed), as in the survey of Bormann et
al., "Room Segmentation: Survey, Implementation, and Analysis", ICRA 2016. Only what stands at the
height of a head divides rooms, so that tables and couches do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from hoid_scene.grid.grid import UNKNOWN, Grid
from hoid_scene.objects.mapped_object import MapObject

# Chosen, none is tuned. Heights between which a wall is searched for: above furniture and below
# the lintels of doors. A cell with at least so many voxels between them has a wall.
_WALL_LOW_M, _WALL_HIGH_M, _WALL_VOXELS = 1.3, 1.9, 4
# Widths up to which gaps in walls, and holes in the known space that furniture hides, are closed.
# If holes up to 1.0 m are closed, a rendered floor has its six rooms and one corridor, and each of
# two other rooms is one room; with 0.2 m, the floor has 10 rooms.
_GAP_M, _HOLE_M = 0.2, 1.0
_DOOR_M = 1.15  # passages up to this width divide rooms
_MIN_AREA_M2 = 2.0  # smaller parts are added to the adjacent room
_CORRIDOR_RATIO = 3.0  # ratio of length to width from which on a room without a use is a corridor
# What a room is used for, by the classes of the things in it; the first use that fits counts.
_USES = (
    ('bathroom', frozenset({'toilet'})),
    ('kitchen', frozenset({'refrigerator', 'oven', 'microwave', 'toaster'})),
    ('bedroom', frozenset({'bed'})),
    ('living room', frozenset({'couch', 'sofa'})),
    ('office', frozenset({'keyboard', 'mouse', 'laptop', 'monitor'})),
)


class Rooms:
    """Rooms with names, in the cells of a grid.

    Attributes:
        labels: (H, W) number of the room of each cell from 1 on; 0: none. Row 0 is at the smallest
            y, as in `Grid`.
        names: Name of each room, by its number minus 1.
    """

    def __init__(
        self, labels: NDArray[np.int32], grid: Grid, objects: Iterable[MapObject]
    ) -> None:
        self.labels, self._grid = labels, grid
        self._T_origin_map = np.linalg.inv(grid.T_map_origin).astype(np.float64)
        inside: dict[int, set[str]] = {n: set() for n in range(1, 1 + int(labels.max(initial=0)))}
        for item in objects:
            if item.is_present and (number := self._number_at(item.center_map_m)):
                inside[number].add(item.class_name)
        names: list[str] = []
        for number, classes in inside.items():
            use = next((use for use, signs in _USES if signs & classes), '')
            use = use or ('corridor' if _is_long(labels == number) else 'room')
            before = sum(name.rstrip(' 0123456789') == use for name in names)
            names.append(f'{use} {before + 1}' if before or use == 'room' else use)
        self.names: Sequence[str] = names

    def name_of(self, item: MapObject) -> str:
        """Return the name of the room of an object; '' if it is in none."""
        number = self._number_at(item.center_map_m)
        return self.names[number - 1] if number else ''

    def _number_at(self, point_map_m: FloatArray) -> int:
        """Return the number of the room at a point (3,) or within 0.5 m of it; 0: none."""
        xy_m = se3.transform(self._T_origin_map, point_map_m[None])[0, :2]
        column, row = np.floor(xy_m / self._grid.resolution_m).astype(int).tolist()
        reach = round(0.5 / self._grid.resolution_m)
        low = max(row - reach, 0), max(column - reach, 0)
        near = self.labels[low[0] : max(row + reach + 1, 0), low[1] : max(column + reach + 1, 0)]
        rows, columns = np.nonzero(near)
        if len(rows) == 0:
            return 0
        distances = np.hypot(rows + low[0] - row, columns + low[1] - column)
        nearest = int(np.argmin(distances))
        return int(near[rows[nearest], columns[nearest]])


def room_name(item: MapObject, rooms: Rooms | None) -> str:
    """Return the name of the room of an object; '' if it is in none, or there are no rooms."""
    return '' if rooms is None else rooms.name_of(item)


def find_rooms(grid: Grid, points_map_m: Float32Array) -> NDArray[np.int32]:
    """Return the number (H, W) of the room of each cell of a grid, from 1 on; 0: none.

    Args:
        points_map_m: (N, 3) points of the dense map.
    """
    known, wall = _known_and_wall(grid, points_map_m)
    known = _closed(known, round(_HOLE_M / grid.resolution_m))
    is_open = (known > 0) & (_closed(wall, round(_GAP_M / grid.resolution_m)) == 0)
    return _without_small(_divided(is_open, grid.resolution_m), grid.resolution_m)


def _closed(mask: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Return a mask (H, W) in which gaps up to a width in cells are closed."""
    kernel = np.ones((width | 1, width | 1), np.uint8)
    padded = np.pad(mask, width)  # beyond the border, nothing is set
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)
    return np.asarray(closed[width:-width, width:-width], np.uint8)


def _known_and_wall(
    grid: Grid, points_map_m: Float32Array
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return which cells (H, W) are known or have points, and which have walls, as 0 and 1."""
    T_origin_map = np.linalg.inv(grid.T_map_origin).astype(np.float64)
    points_m = se3.transform(T_origin_map, points_map_m.astype(np.float64))
    columns, rows = np.floor(points_m[:, :2] / grid.resolution_m).astype(np.int64).T
    height, width = grid.cells.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    inside &= points_m[:, 2] < _WALL_HIGH_M
    is_high = inside & (points_m[:, 2] > _WALL_LOW_M)

    def counted(which: BoolArray) -> IntArray:
        at = rows[which] * width + columns[which]
        return np.bincount(at, minlength=height * width).reshape(height, width)

    is_known = (grid.cells != UNKNOWN) | (counted(inside) > 0)
    is_wall = counted(is_high) >= _WALL_VOXELS
    return is_known.astype(np.uint8), is_wall.astype(np.uint8)


def _divided(is_open: BoolArray, resolution_m: float) -> NDArray[np.int32]:
    """Return the parts (H, W) of the open cells between narrow passages; 0: not open."""
    padded = np.pad(is_open.astype(np.uint8), 1)  # beyond the border, nothing is open
    distance_m = resolution_m * cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    num, cores = cv2.connectedComponents((distance_m > _DOOR_M / 2).astype(np.uint8))
    labels = np.where(padded > 0, cores, num).astype(np.int32)  # walls are a part as well
    # All open space has height 0, so that all parts grow at the same speed, and walls are flooded
    # last. If the distance were the height, as is usual, strips along the walls of a room would be
    # assigned to another room.
    height = np.where(padded > 0, 0, 255).astype(np.uint8)
    cv2.watershed(cv2.merge([height] * 3), labels)
    labels[(labels == num) | (padded == 0) | (labels < 0)] = 0
    for _ in range(2):  # the cells where two parts meet
        grown = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
        labels = np.where((labels == 0) & (padded > 0), grown, labels)
    return np.asarray(labels[1:-1, 1:-1], np.int32)


def _without_small(labels: NDArray[np.int32], resolution_m: float) -> NDArray[np.int32]:
    """Return the parts (H, W), numbered from 1 on; small parts are added to adjacent parts."""
    least = _MIN_AREA_M2 / resolution_m**2
    sizes = np.bincount(labels.reshape(-1))
    order = [
        n for n in np.argsort(sizes, kind='stable').tolist() if n > 0 and 0 < sizes[n] < least
    ]
    for number in order:
        mask = (labels == number).astype(np.uint8)
        ring = (cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0) & (mask == 0)
        beside = np.bincount(labels[ring], minlength=1)
        beside[0] = 0
        labels = np.where(mask > 0, int(np.argmax(beside)), labels)
    _, numbered = np.unique(labels, return_inverse=True)
    has_none = int((labels == 0).any())
    return np.asarray(numbered.reshape(labels.shape) + (1 - has_none), np.int32)


def _is_long(mask: BoolArray) -> bool:
    rows, columns = np.nonzero(mask)
    _, sides, _ = cv2.minAreaRect(np.stack([columns, rows], axis=1).astype(np.int32))
    short, long = sorted(sides)
    return long >= _CORRIDOR_RATIO * max(short, 1.0)
