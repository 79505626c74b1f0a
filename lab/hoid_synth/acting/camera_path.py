"""Trajectories of a hand-held camera: a smooth path with tremor."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.config import FLOOR, SceneConfig
from hoid_synth.floor.route import floor_route
from hoid_synth.noise import Rng
from hoid_synth.room.layout import LANES_Y_M, PARTITION_M, WIDTHS_M

HEIGHT_M = 1.45
LOOP_SPEED_MPS = 0.645
_LOOP_MARGIN_M = 1.5
_CORNER_M = 0.75
FRONT_Y_M = 1.0
TAKE_S = 5.0
"""Length of the first take of the path "takes"."""
_TURN_DPS = (100.0, 300.0)  # fastest rates of the turns of this path
_TURNS = 12


def camera_poses(config: SceneConfig, times_s: FloatArray) -> FloatArray:
    """Return T_world_camera (N, 4, 4) of the optical frame at times (N,) since the first frame."""
    rng = np.random.default_rng([config.seed, 2])
    if config.path == FLOOR:
        position, yaw, pitch = _floor(rng, times_s, config.num_rooms)
    else:
        makers = {
            'loop': _loop,
            'room': _room,
            'xyz': _xyz,
            'rpy': _rpy,
            'static': _static,
            'takes': _takes,
        }
        position, yaw, pitch = makers[config.path](rng, times_s)
    roll = np.radians(1.2) * _wander(rng, times_s, 0.25)
    tremor = _tremor(rng, times_s)
    position = position + 0.0035 * tremor[:, :3]
    angles = np.radians(0.28) * tremor[:, 3:]
    if config.path == 'rpy':
        roll = roll + np.radians(16) * np.sin(2 * np.pi * times_s / 3.1)
    pitch = pitch - np.radians(config.pitch_deg)
    roll = roll + np.radians(config.roll_deg)
    return _poses(position, yaw + angles[:, 0], pitch + angles[:, 1], roll + angles[:, 2])


def _wander(rng: Rng, t: FloatArray, rate_hz: float) -> FloatArray:
    """Return smooth noise (N,) of about [-1, 1], with most power below `rate_hz`."""
    rates = rate_hz * np.array([0.37, 0.71, 1.0])
    phases = rng.uniform(0, 2 * np.pi, 3)
    weights = np.array([0.5, 0.35, 0.25])
    return np.asarray(np.sin(2 * np.pi * t[:, None] * rates + phases) @ weights)


def _tremor(rng: Rng, t: FloatArray) -> FloatArray:
    """Return noise (N, 6) from 0.8 to 7 Hz whose amplitude falls with frequency."""
    rates = np.geomspace(0.8, 7.0, 7) * rng.uniform(0.9, 1.1, (6, 7))
    phases = rng.uniform(0, 2 * np.pi, (6, 7))
    waves = np.sin(2 * np.pi * t[:, None, None] * rates + phases)
    return np.asarray((waves / rates**1.2).sum(-1))


Path = tuple[FloatArray, FloatArray, FloatArray]
"""Position (N, 3) in m, yaw (N,) and pitch (N,) in rad; pitch is positive upwards."""


def _look_at(position: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    way = target - position
    flat = np.hypot(way[:, 0], way[:, 1])
    return np.arctan2(way[:, 1], way[:, 0]), np.arctan2(way[:, 2], flat)


def _sweep(
    rng: Rng, t: FloatArray, amplitude: tuple[float, float, float], period_s: float
) -> FloatArray:
    middle = np.array([WIDTHS_M[0] / 2, FRONT_Y_M, HEIGHT_M])
    periods = period_s * rng.uniform(0.85, 1.2, 3) * [1.0, 0.71, 0.57]
    phase = rng.uniform(0, 2 * np.pi, 3)
    return np.asarray(middle + np.sin(2 * np.pi * t[:, None] / periods + phase) * amplitude)


def _room(rng: Rng, t: FloatArray) -> Path:
    position = _sweep(rng, t, (1.15, 0.3, 0.14), 10.0)
    target = np.stack(
        [
            WIDTHS_M[0] / 2
            + 1.3 * _wander(rng, t, 0.16)
            - 0.25 * (position[:, 0] - WIDTHS_M[0] / 2),
            np.full(len(t), 4.4),
            0.95 + 0.25 * _wander(rng, t, 0.2),
        ],
        -1,
    )
    return position, *_look_at(position, target)


def _xyz(rng: Rng, t: FloatArray) -> Path:
    position = _sweep(rng, t, (0.4, 0.3, 0.22), 6.0)
    yaw = np.pi / 2 + np.radians(2.5) * _wander(rng, t, 0.4)
    return position, yaw, np.radians(-9 + 2.0 * _wander(rng, t, 0.4))


def _rpy(rng: Rng, t: FloatArray) -> Path:
    position = _sweep(rng, t, (0.1, 0.08, 0.06), 5.0)
    yaw = np.pi / 2 + np.radians(24) * np.sin(2 * np.pi * t / rng.uniform(3.6, 4.4))
    return position, yaw, np.radians(-8 + 11 * np.sin(2 * np.pi * t / rng.uniform(2.5, 3.2)))


def _static(rng: Rng, t: FloatArray) -> Path:
    position = _sweep(rng, t, (0.02, 0.015, 0.01), 7.0)
    return position, np.pi / 2 + 0 * t, np.radians(-9) + 0 * t


def _takes(rng: Rng, t: FloatArray) -> Path:
    """Look around the room in two takes, which begin at other places and in other directions."""
    first, second = _look_around(rng, t, 0), _look_around(rng, t - TAKE_S, 1)
    is_second = t >= TAKE_S
    position = np.where(is_second[:, None], second[0], first[0])
    yaw, pitch = (np.where(is_second, b, a) for a, b in zip(first[1:], second[1:], strict=True))
    return position, yaw, pitch


def _look_around(rng: Rng, t: FloatArray, take: int) -> Path:
    """Turn around at a place, with a rest before each jerky turn; take 1 turns the other way."""
    turn_rad = np.radians(rng.uniform(35, 90, _TURNS)) * (-1) ** take
    duration_s = np.pi / 2 * np.abs(turn_rad) / np.radians(rng.uniform(*_TURN_DPS, _TURNS))
    start_s = np.cumsum(rng.uniform(0.15, 0.5, _TURNS) + duration_s) - duration_s
    share = np.clip((t[:, None] - start_s) / duration_s, 0, 1)
    yaw = rng.uniform(0, 2 * np.pi) + (1 - np.cos(np.pi * share)) / 2 @ turn_rad
    middle = np.array([WIDTHS_M[0] / 2 + (-1) ** take * 0.5, 1.7 + 0.5 * take, HEIGHT_M])
    sway = [0.3, 0.3, 0.1] * np.stack([_wander(rng, t, 0.3) for _ in range(3)], -1)
    return middle + sway, yaw, np.radians(-14 + 6 * _wander(rng, t, 0.3))


def loop_line() -> FloatArray:
    """Return points (N, 2) every centimeter along the closed loop."""
    x1, x2 = _LOOP_MARGIN_M, sum(WIDTHS_M) + PARTITION_M - _LOOP_MARGIN_M
    y1, y2 = LANES_Y_M
    r, pieces = _CORNER_M, []
    corners = [(x2, y1, -np.pi / 2), (x2, y2, 0), (x1, y2, np.pi / 2), (x1, y1, np.pi)]
    for x, y, start in corners:
        middle = np.array([x + (r if x == x1 else -r), y + (r if y == y1 else -r)])
        angle = np.linspace(start, start + np.pi / 2, 60)
        pieces.append(middle + r * np.stack([np.cos(angle), np.sin(angle)], -1))
    first = np.array([[x1 + r, y1]])
    corner_points = np.concatenate([first, *pieces])
    length = _lengths(corner_points)
    s = np.arange(0, length[-1], 0.01)
    return np.stack([np.interp(s, length, corner_points[:, k]) for k in range(2)], -1)


def _lengths(points: FloatArray) -> FloatArray:
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _loop(rng: Rng, t: FloatArray) -> Path:
    line = loop_line()
    step = np.roll(line, -30, 0) - np.roll(line, 30, 0)  # heading, smoothed over 0.6 m
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    kernel = np.hanning(161) / np.hanning(161).sum()
    turn = 2 * np.pi
    padded = np.concatenate([heading[-80:] - turn, heading, heading[:80] + turn])
    heading = np.convolve(padded, kernel, 'valid')
    s = t * LOOP_SPEED_MPS * 100
    laps, at = np.divmod(s, len(line))
    wrapped = np.concatenate([line, line[:1]])
    position = np.stack(
        [np.interp(at, np.arange(len(wrapped)), wrapped[:, k]) for k in range(2)], -1
    )
    heading = (
        np.interp(at, np.arange(len(wrapped)), np.append(heading, heading[0] + turn)) + laps * turn
    )
    height = HEIGHT_M + 0.05 * _wander(rng, t, 0.3)
    yaw = heading + np.radians(22) + np.radians(24) * _wander(rng, t, 0.14)
    pitch = np.radians(-8 + 4 * _wander(rng, t, 0.2))
    sway = 0.05 * np.stack([_wander(rng, t, 0.3), _wander(rng, t, 0.3)], -1)
    return np.concatenate([position + sway, height[:, None]], 1), yaw, pitch


def _floor(rng: Rng, t: FloatArray, num_rooms: int) -> Path:
    """Follow the route of a robot, and look a little to its left and right."""
    xy, heading = floor_route(num_rooms).at(t)
    height = HEIGHT_M + 0.02 * _wander(rng, t, 0.3)
    yaw = heading + np.radians(8) * _wander(rng, t, 0.14)
    pitch = np.radians(-6 + 3 * _wander(rng, t, 0.2))
    return np.concatenate([xy, height[:, None]], 1), yaw, pitch


def _poses(
    position: FloatArray, yaw: FloatArray, pitch: FloatArray, roll: FloatArray
) -> FloatArray:
    z = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], -1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), 0 * yaw], -1)
    down = np.cross(z, right)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    T = np.zeros((len(yaw), 4, 4))
    T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = c * right + s * down, c * down - s * right, z
    T[:, :3, 3], T[:, 3, 3] = position, 1.0
    return T
