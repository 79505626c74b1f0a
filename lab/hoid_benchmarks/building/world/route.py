"""Routes through a building: camera poses at a constant rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_benchmarks.building.world.floors import (
    STAIRS_M,
    STOREY_M,
    Building,
    Cell,
    CellKey,
    CellKind,
)
from hoid_common.values import NS_PER_S, FloatArray, IntArray, Trajectory

RATE_HZ = 10.0
START_NS = NS_PER_S  # stamp of the first image
CORNER, FULL_TURN = 'corner', 'full turn'
SPEED_MPS = 0.5
_TURN_RAD_PER_S, _TURN_RAD_PER_S2 = np.deg2rad(42), np.deg2rad(120)
_MIN_TURN_RAD_PER_S = 0.02  # so that a turn comes to its end
_EYE_M, _PITCH_RAD = 1.1, np.deg2rad(3)
_INTO_ROOM_M = 2.3
_WOBBLE, _WOBBLE_IMAGES = 0.004, 20  # rad and m, over how many images it is smoothed
_EPSILON = 1e-6


class Route:
    """A route at a constant speed with turns on the spot, appended leg by leg.

    `marks` holds the numbers of the images at which a turn at a corner or a full turn begins.

    Args:
        building: The building in which the route lies.
        column: Column of the junction where the route starts.
        row: Row of the junction where the route starts.
        yaw_rad: Heading at the start, counterclockwise from x.
        floor: Floor of the start.
        speed_mps: Speed between the turns.
    """

    def __init__(
        self,
        building: Building,
        column: int = 0,
        row: int = 0,
        yaw_rad: float = 0.0,
        floor: int = 0,
        speed_mps: float = SPEED_MPS,
    ) -> None:
        self.building = building
        self._speed_mps = speed_mps
        self._floor = floor
        self._at_m = building.junction_m(floor, column, row)
        self._yaw_rad = yaw_rad
        self._poses: list[tuple[float, float, float, float]] = []  # x, y, z of the ground, yaw
        self.marks: list[tuple[int, str]] = []
        self._append(self._at_m, yaw_rad)

    def __len__(self) -> int:
        return len(self._poses)

    def to_junction(self, column: int, row: int, rooms: int = 0) -> None:
        """Drive straight to a junction of this corridor, and visit rooms on the first block."""
        target_m = self.building.junction_m(self._floor, column, row)
        if rooms:
            for key in self._rooms_towards(target_m)[:rooms]:
                self.visit(key)
        self._drive(target_m)

    def around(self, columns: int, rows: int, rooms: int = 0, every: int = 1) -> None:
        """Drive around a rectangle of blocks, and visit rooms on each `every`-th one."""
        x, y = np.rint(self._at_m[:2] / self.building.block_m).astype(int).tolist()
        legs = ((1, 0, columns), (0, 1, rows), (-1, 0, columns), (0, -1, rows))
        steps = [(dx, dy) for dx, dy, count in legs for _ in range(count)]
        for n, (dx, dy) in enumerate(steps):
            x, y = x + dx, y + dy
            self.to_junction(x, y, rooms if n % every == 0 else 0)

    def visit(self, key: CellKey) -> None:
        """Enter a room of this corridor, turn around once, and come out again."""
        cell = self.building.cells[key]
        outside_m = np.array([cell.center_m[0], self._at_m[1], self._at_m[2]])
        inside_m = outside_m.copy()
        inside_m[1] = _inside_y_m(cell)
        self._drive(outside_m)
        self._drive(inside_m)
        self.marks.append((len(self), FULL_TURN))
        self._turn(2 * np.pi)
        self._drive(outside_m)

    def climb(self) -> None:
        """Take the staircase at this junction, up and back, to the next floor."""
        bottom_m = self._at_m
        for step_m in ((-STAIRS_M, 0, STOREY_M / 2), (0, 0, STOREY_M)):
            self._drive(bottom_m + np.array(step_m))
        self._floor += 1

    def poses(self, seed: int = 0) -> FloatArray:
        """Return T_world_camera (N, 4, 4) of the optical frame, with a wobble of 4 mm and 4 mrad.

        The world is z up; the camera looks ahead and 3 degrees down.
        """
        p = np.array(self._poses)
        n = len(p)
        rng = np.random.default_rng([seed, 3])
        wobble = _WOBBLE * np.stack([_smooth_noise(rng, n) for _ in range(3)], 1)
        yaw, pitch, roll = p[:, 3] + wobble[:, 0], _PITCH_RAD + wobble[:, 1], wobble[:, 2]
        ahead = np.stack(
            [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)], 1
        )
        level = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros(n)], 1)
        under = np.cross(ahead, level)
        c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
        T = np.tile(np.eye(4), (n, 1, 1))
        T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = c * level + s * under, c * under - s * level, ahead
        T[:, :3, 3] = p[:, :3]
        T[:, 2, 3] += _EYE_M + wobble[:, 1]
        return T

    def trajectory(self, seed: int = 0) -> Trajectory:
        """Return the poses with the stamps of the images."""
        return Trajectory(stamps_ns(len(self)), self.poses(seed))

    def _rooms_towards(self, target_m: FloatArray) -> list[CellKey]:
        """Return the rooms on both sides of the block ahead in this corridor, nearest first."""
        sign = int(np.sign(target_m[0] - self._at_m[0]))
        if sign == 0:
            return []
        column, row = np.rint(self._at_m[:2] / self.building.block_m).astype(int).tolist()
        column -= sign < 0
        keys = [
            CellKey(CellKind.ROOM, self._floor, column, row - north, east, north)
            for north in (0, 1)
            for east in (0, 1)
        ]
        return sorted(
            (key for key in keys if key in self.building.cells),
            key=lambda key: sign * self.building.cells[key].low_m[0],
        )

    def _drive(self, target_m: FloatArray) -> None:
        """Turn towards a point and drive straight to it."""
        way_m = target_m - self._at_m
        length_m = float(np.linalg.norm(way_m))
        if length_m < _EPSILON:
            return
        yaw_rad = float(np.arctan2(way_m[1], way_m[0]))
        turn_rad = (yaw_rad - self._yaw_rad + np.pi) % (2 * np.pi) - np.pi
        if abs(turn_rad) > _EPSILON:
            self.marks.append((len(self), CORNER))
            self._turn(turn_rad)
        steps = max(int(np.ceil(length_m * RATE_HZ / self._speed_mps)), 1)
        for share in (np.arange(1, steps + 1) / steps).tolist():
            self._append(self._at_m + share * way_m, self._yaw_rad)
        self._at_m = target_m

    def _turn(self, angle_rad: float) -> None:
        """Turn on the spot, with a ramp of the angular velocity at both ends."""
        done, rate, sign, total = 0.0, 0.0, np.sign(angle_rad), abs(angle_rad)
        while total - done > _EPSILON:
            braking = np.sqrt(2 * _TURN_RAD_PER_S2 * (total - done))
            faster = rate + _TURN_RAD_PER_S2 / RATE_HZ
            rate = float(min(faster, _TURN_RAD_PER_S, max(braking, _MIN_TURN_RAD_PER_S)))
            done = min(done + rate / RATE_HZ, total)
            self._append(self._at_m, self._yaw_rad + sign * done)
        self._yaw_rad += angle_rad

    def _append(self, ground_m: FloatArray, yaw_rad: float) -> None:
        x, y, z = ground_m.tolist()
        self._poses.append((x, y, z, yaw_rad))


def stamps_ns(count: int) -> IntArray:
    """Return the (N,) stamps of the images of a route."""
    return START_NS + np.rint(np.arange(count) * NS_PER_S / RATE_HZ).astype(np.int64)


def first_mark(marks: Sequence[tuple[int, str]], name: str, after: int = 0) -> int:
    """Return the number of the first image with a mark, from image `after` on."""
    return next(n for n, found in marks if found == name and n >= after)


def _inside_y_m(cell: Cell) -> float:
    """Return the y coordinate of the place in a room where the camera turns around."""
    if cell.key.north:
        return float(cell.high_m[1]) - _INTO_ROOM_M
    return float(cell.low_m[1]) + _INTO_ROOM_M


def _smooth_noise(rng: np.random.Generator, count: int) -> FloatArray:
    kernel = np.ones(_WOBBLE_IMAGES) / np.sqrt(_WOBBLE_IMAGES)
    noise = np.convolve(rng.normal(0, 1, count + 2 * _WOBBLE_IMAGES), kernel, 'same')
    return np.asarray(noise[_WOBBLE_IMAGES:][:count])
