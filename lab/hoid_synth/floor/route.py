"""Drive of a robot through all rooms of a floor, and around it again."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.floor.plan import FloorPlan, FloorRoom, floor_plan

SPEED_MPS = 0.8
_ACCELERATION_MPS2 = 0.8
_TURN_RAD_PER_S, _TURN_RAD_PER_S2 = np.radians(60), np.radians(150)
INTO_ROOM_M = 1.4
_KEEPS_RIGHT_M = 0.3  # of the middle of a corridor, so that people can pass
_END_M = 1.2  # from the end of a single corridor
_EPSILON = 1e-6
# For each lap: 1, every room is visited; 2, every second one; 0, none.
_LAPS = (1, 2, 0)


class Visit(NamedTuple):
    """A stay in a room, from the turn towards its door until the camera has left it."""

    room: FloorRoom
    first_s: float
    last_s: float


class FloorRoute:
    """Positions and headings over time: straight legs, and turns on the spot.

    Attributes:
        visits: The stays in rooms, in their order.
        duration_s: Time until the end of the route.
    """

    def __init__(self, plan: FloorPlan) -> None:
        self._plan = plan
        self.visits: list[Visit] = []
        # Rows of time, x, y, yaw at the end of each leg or turn.
        x1, y1, _, y2 = plan.main[0]
        start_x = x1 + _END_M
        self._rows: list[tuple[float, float, float, float]] = [
            (0.0, start_x, (y1 + y2) / 2 - _KEEPS_RIGHT_M, 0.0)
        ]
        for every in _LAPS if plan.cross else _LAPS[:1]:
            self._lap(every)
        self.duration_s = self._rows[-1][0]

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions (N, 2) and headings (N,) at times (N,); it rests after the end."""
        rows = np.array(self._rows)
        k = np.clip(np.searchsorted(rows[:, 0], times_s, 'right') - 1, 0, len(rows) - 2)
        begin, end = rows[k], rows[k + 1]
        way_m = np.linalg.norm(end[:, 1:3] - begin[:, 1:3], axis=1)
        turn_rad = np.abs(end[:, 3] - begin[:, 3])
        elapsed_s = times_s - begin[:, 0]
        share = np.where(
            way_m > _EPSILON,
            _share(elapsed_s, way_m, SPEED_MPS, _ACCELERATION_MPS2),
            _share(elapsed_s, turn_rad, _TURN_RAD_PER_S, _TURN_RAD_PER_S2),
        )
        state = begin[:, 1:] + share[:, None] * (end[:, 1:] - begin[:, 1:])
        return state[:, :2], state[:, 2]

    @property
    def length_m(self) -> float:
        """Return the distance travelled."""
        xy = np.array(self._rows)[:, 1:3]
        return float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())

    def _lap(self, every: int) -> None:
        """Drive along each main corridor and back to the start; visit every `every`-th room."""
        (x1, y1, x2, y2), *others = self._plan.main
        lane_m = (y1 + y2) / 2 - _KEEPS_RIGHT_M
        rooms = list(self._plan.rooms_of(0))
        self._along(lane_m, [r for n, r in enumerate(rooms) if every and n % every == 0])
        start_x = x1 + _END_M
        if not others:
            self._drive(x2 - _END_M, lane_m)
            self._drive(x2 - _END_M, lane_m + 2 * _KEEPS_RIGHT_M)
            self._drive(start_x, lane_m + 2 * _KEEPS_RIGHT_M)
            self._drive(start_x, lane_m)
            return
        west, east = self._plan.cross
        east_x = (east[0] + east[2]) / 2 + _KEEPS_RIGHT_M
        west_x = (west[0] + west[2]) / 2 - _KEEPS_RIGHT_M
        far_lane_m = (others[0][1] + others[0][3]) / 2 + _KEEPS_RIGHT_M
        self._drive(east_x, lane_m)
        self._drive(east_x, far_lane_m)
        rooms = list(self._plan.rooms_of(1))[::-1]
        self._along(far_lane_m, [r for n, r in enumerate(rooms) if every and n % every == 0])
        self._drive(west_x, far_lane_m)
        self._drive(west_x, lane_m)
        self._drive(start_x, lane_m)

    def _along(self, lane_m: float, rooms: list[FloorRoom]) -> None:
        for room in rooms:
            self._drive(room.door_x_m, lane_m)
            first_s = self._rows[-1][0]
            y1, y2 = room.rect[1], room.rect[3]
            self._drive(
                room.door_x_m, y2 - INTO_ROOM_M if room.is_door_north else y1 + INTO_ROOM_M
            )
            self._drive(room.door_x_m, lane_m)
            self.visits.append(Visit(room, first_s, self._rows[-1][0]))

    def _drive(self, x: float, y: float) -> None:
        """Turn towards a point and drive straight to it."""
        _, x0, y0, yaw = self._rows[-1]
        length_m = float(np.hypot(x - x0, y - y0))
        if length_m < _EPSILON:
            return
        turn = (np.arctan2(y - y0, x - x0) - yaw + np.pi) % (2 * np.pi) - np.pi
        if abs(abs(turn) - np.pi) < _EPSILON:  # about to the left and to the right in turn
            turn = np.pi * (1 - 2 * (len(self.visits) % 2))
        yaw = yaw + float(turn)
        if abs(turn) > _EPSILON:
            self._append(_duration_s(abs(turn), _TURN_RAD_PER_S, _TURN_RAD_PER_S2), x0, y0, yaw)
        self._append(_duration_s(length_m, SPEED_MPS, _ACCELERATION_MPS2), x, y, yaw)

    def _append(self, duration_s: float, x: float, y: float, yaw_rad: float) -> None:
        self._rows.append((self._rows[-1][0] + duration_s, x, y, yaw_rad))


@lru_cache
def floor_route(num_rooms: int) -> FloorRoute:
    """Return the route through a floor with so many rooms."""
    return FloorRoute(floor_plan(num_rooms))


def _duration_s(way: float, speed: float, acceleration: float) -> float:
    """Return the time of a motion with equal ramps of the speed at both ends."""
    top = min(speed, float(np.sqrt(way * acceleration)))
    return way / top + top / acceleration


def _share(
    elapsed_s: FloatArray, way: FloatArray, speed: float, acceleration: float
) -> FloatArray:
    """Return the done shares (N,) of motions with equal ramps of the speed at both ends."""
    way = np.maximum(way, _EPSILON)
    top = np.minimum(speed, np.sqrt(way * acceleration))
    ramp_s, total_s = top / acceleration, way / top + top / acceleration
    t = np.clip(elapsed_s, 0, total_s)
    left_s = total_s - t
    done = np.where(
        t < ramp_s,
        acceleration * t**2 / 2,
        np.where(left_s < ramp_s, way - acceleration * left_s**2 / 2, top * (t - ramp_s / 2)),
    )
    return np.asarray(done / way)
