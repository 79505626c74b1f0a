"""Plan of a floor: rows of rooms along one corridor, or along two corridors of a ring.

Coordinates are in m, x along the corridors, the origin in the corner of the bounding box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.mesh import Rect

ROOM_WIDTH_M, ROOM_DEPTH_M = 6.2, 5.6
WALL_M = 0.12
CORRIDOR_M = 2.4
DOOR_M = 1.0
RING_ROOMS = 8  # from here on there are two corridors
_ROWS_PER_CORRIDOR = 2


@dataclass(frozen=True)
class FloorRoom:
    """A room whose door is in the middle of the wall to its corridor."""

    rect: Rect
    is_door_north: bool

    @property
    def door_x_m(self) -> float:
        """Return the x coordinate of the middle of the door."""
        return (self.rect[0] + self.rect[2]) / 2

    @property
    def pose(self) -> FloatArray:
        """Return T_world_room (4, 4) of the corner from which x runs along the door's wall."""
        x1, y1, x2, y2 = self.rect
        s = -1.0 if self.is_door_north else 1.0
        T = np.diag([s, s, 1.0, 1.0])
        T[:2, 3] = (x2, y2) if self.is_door_north else (x1, y1)
        return T

    @property
    def doorway(self) -> Rect:
        """Return the floor between room and corridor."""
        x, y1, y2 = self.door_x_m, self.rect[1], self.rect[3]
        low = y2 if self.is_door_north else y1 - WALL_M
        return x - DOOR_M / 2, low, x + DOOR_M / 2, low + WALL_M


@dataclass(frozen=True)
class FloorPlan:
    """Rooms and corridors.

    Attributes:
        rooms: Rows from south to north, each from west to east.
        main: Corridors along x, which have the doors, from south to north.
        cross: Corridors along y that join the ends of two main ones; empty for one corridor.
    """

    rooms: tuple[FloorRoom, ...]
    main: tuple[Rect, ...]
    cross: tuple[Rect, ...]

    def rooms_of(self, corridor: int) -> tuple[FloorRoom, ...]:
        """Return the rooms with doors to a main corridor, from west to east."""
        row = len(self.rooms) // (len(self.main) * _ROWS_PER_CORRIDOR)
        first = corridor * _ROWS_PER_CORRIDOR * row
        rooms = self.rooms[first : first + _ROWS_PER_CORRIDOR * row]
        return tuple(sorted(rooms, key=lambda room: room.door_x_m))


@lru_cache
def floor_plan(num_rooms: int) -> FloorPlan:
    """Return the plan of a floor with at least so many rooms, the same number in each row."""
    num_main = 2 if num_rooms >= RING_ROOMS else 1
    num_rows = num_main * _ROWS_PER_CORRIDOR
    columns = -(-num_rooms // num_rows)
    is_ring = num_main == 2
    first_m = CORRIDOR_M + WALL_M if is_ring else 0.0
    xs = first_m + np.arange(columns) * (ROOM_WIDTH_M + WALL_M)
    width_m = float(xs[-1]) + ROOM_WIDTH_M + first_m
    rooms, main, y = [], [], 0.0
    for _ in range(num_main):
        corridor_y = y + ROOM_DEPTH_M + WALL_M
        north_y = corridor_y + CORRIDOR_M + WALL_M
        for row_y, is_door_north in ((y, True), (north_y, False)):
            for x in xs.tolist():
                rect = (x, row_y, x + ROOM_WIDTH_M, row_y + ROOM_DEPTH_M)
                rooms.append(FloorRoom(rect, is_door_north))
        main.append((0.0, corridor_y, width_m, corridor_y + CORRIDOR_M))
        y = north_y + ROOM_DEPTH_M + WALL_M
    cross: tuple[Rect, ...] = ()
    if is_ring:
        low, high = main[0][1], main[1][3]
        cross = (
            (0.0, low, CORRIDOR_M, high),
            (width_m - CORRIDOR_M, low, width_m, high),
        )
    return FloorPlan(tuple(rooms), tuple(main), cross)
