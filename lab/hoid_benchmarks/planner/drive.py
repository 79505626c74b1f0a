"""Drives of a robot through a room with people, who do not notice it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.planner.costmap import (
    CELL_M,
    ROBOT_RADIUS_M,
    Costmap,
    cell_of,
    centers_m,
    step_down,
)
from hoid_common.values import NS_PER_S, PERSON, BoolArray, FloatArray, ObjectState
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.grid.grid import GridExtent
from hoid_scene.navigation_masks import CLOSED, Mask, NavigationMasks
from hoid_scene.tracks.object_track import TrackedObject
from hoid_synth.acting.stage import Stage

PERSON_RADIUS_M = 0.25  # chosen: half the width of a person
INTRUSION_M = 0.45  # a smaller gap is in the intimate zone (Hall, The Hidden Dimension, 1966)
_SPEED_MPS = 0.5  # chosen: a slow robot for rooms
_STEP_S, _EVERY = 0.1, 3  # time of a step, and frames of the 30 Hz motion in it
_RANGE_M = 5.0  # the robot knows the people within this distance, in all directions
_ARRIVED_M = 0.15
_LIMIT_S = 30.0  # a drive that takes longer has failed
_VELOCITY_FRAMES = 15  # over which the velocity of a person is measured, as a tracker does


class Layers(Enum):
    """What the planner knows of people."""

    PLAIN = 'plain costmap'  # the obstacle layer: where they are
    MASKS = 'with masks'  # the keep-out and the speed filter as well


class Drive(NamedTuple):
    """Result of a drive from one place to another."""

    duration_s: float  # inf: the goal was not reached
    nearest_m: float  # smallest gap between the robot and a person
    num_intrusions: int  # times that the gap became smaller than INTRUSION_M
    moving_m: float  # smallest gap while the robot moved; inf if it never did


def drive(
    stage: Stage,
    is_occupied: BoolArray,
    layers: Layers,
    way_m: tuple[FloatArray, FloatArray],
    start_s: float,
) -> Drive:
    """Drive from one place to another among people.

    Args:
        stage: The motions of people.
        is_occupied: (H, W) cells of furniture and walls.
        layers: What the planner knows.
        way_m: Start and goal, (2,) each.
        start_s: Time of the start; the people before it are counted for the speed mask.
    """
    at_m, goal_m = way_m
    planner = _Planner(is_occupied, layers, goal_m)
    gaps_m, moved = [], []
    for k in range(round((start_s + _LIMIT_S) / _STEP_S)):
        tracks = _tracks(stage, k * _EVERY, at_m)
        planner.note(tracks, at_m, k)
        if k * _STEP_S < start_s:
            continue
        after_m = planner.step(tracks, at_m)
        moved.append(after_m is not None)
        at_m = at_m if after_m is None else after_m
        gaps_m.append(_gap_m(stage, (k + 1) * _EVERY, at_m))
        if np.linalg.norm(at_m - goal_m) < _ARRIVED_M:
            return _result((k + 1) * _STEP_S - start_s, np.array(gaps_m), np.array(moved))
    return _result(np.inf, np.array(gaps_m), np.array(moved))


class _Planner:
    """Plans the way to a goal anew in each step."""

    def __init__(self, is_occupied: BoolArray, layers: Layers, goal_m: FloatArray) -> None:
        self._is_occupied, self._layers, self._goal_m = is_occupied, layers, goal_m
        self._masks = NavigationMasks(NavigationConfig(enabled=True))
        height, width = is_occupied.shape
        self._extent = GridExtent((0, 0), (height, width), CELL_M)
        self._keep_out, self._speed = self._both()

    def _both(self) -> tuple[Mask, Mask]:
        return self._masks.keep_out(self._extent), self._masks.speed(self._extent)

    def note(self, tracks: tuple[TrackedObject, ...], at_m: FloatArray, step: int) -> None:
        """Update the masks with the people of a step, if the masks are due."""
        T_map_base = np.eye(4)
        T_map_base[:2, 3] = at_m
        if self._masks.update(tracks, T_map_base, round(step * _STEP_S * NS_PER_S)):
            self._keep_out, self._speed = self._both()

    def step(self, tracks: tuple[TrackedObject, ...], at_m: FloatArray) -> FloatArray | None:
        """Return the position (2,) of the robot after a step; None: it waits."""
        closed = self._is_occupied | _at_people(tracks, self._is_occupied.shape)
        limit_mps = _SPEED_MPS
        if self._layers is Layers.MASKS:
            closed |= self._keep_out.cells == CLOSED
            limit_mps *= 1 - self._speed.cells[cell_of(at_m)] / 100
        to_go = Costmap.of(closed).to_go(cell_of(self._goal_m))
        return step_down(to_go, at_m, limit_mps * _STEP_S)


def _result(duration_s: float, gaps_m: FloatArray, moved: BoolArray) -> Drive:
    is_close = gaps_m < INTRUSION_M
    num_intrusions = int(np.count_nonzero(is_close & ~np.r_[False, is_close[:-1]]))
    moving_m = float(gaps_m[moved].min()) if moved.any() else np.inf
    return Drive(duration_s, float(gaps_m.min()), num_intrusions, moving_m)


def _tracks(stage: Stage, frame: int, at_m: FloatArray) -> tuple[TrackedObject, ...]:
    """Return the people near a position (2,), with the velocities that a tracker measures."""
    out = []
    for n, body in enumerate(stage.bodies):
        frame = min(frame, len(body.xy_m) - 1)
        before = max(frame - _VELOCITY_FRAMES, 0)
        xy, old = body.xy_m[frame], body.xy_m[before]
        if np.linalg.norm(xy - at_m) > _RANGE_M:
            continue
        seconds = max(frame - before, 1) * _STEP_S / _EVERY
        velocity = np.array([*(xy - old) / seconds, 0.0])
        position, size = np.array([*xy, 0.9]), np.array([0.5, 0.5, 1.8])
        out.append(
            TrackedObject(n + 1, PERSON, ObjectState.PERSON, 0, 1.0, position, velocity, size)
        )
    return tuple(out)


def _gap_m(stage: Stage, frame: int, at_m: FloatArray) -> float:
    """Return the gap between the robot and the nearest person."""
    people = np.array([body.xy_m[min(frame, len(body.xy_m) - 1)] for body in stage.bodies])
    distance_m = float(np.linalg.norm(people - at_m, axis=1).min())
    return distance_m - PERSON_RADIUS_M - ROBOT_RADIUS_M


def _at_people(tracks: tuple[TrackedObject, ...], shape: tuple[int, ...]) -> BoolArray:
    """Return the cells (H, W) that people cover, which an obstacle layer marks."""
    at = np.array([track.position_map_m[:2] for track in tracks]).reshape(-1, 2)
    gaps_m = np.linalg.norm(centers_m((shape[0], shape[1]))[:, :, None] - at, axis=3)
    return np.asarray((gaps_m <= PERSON_RADIUS_M).any(axis=2))
