"""Scenario `lag`: what a late mapper does to tracking.

The mapper answers every keyframe late by a constant delay, or is too slow for the keyframes that
it gets, or is stalled once at the worst moment: at a corner or in a full turn, where the view
changes completely within seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hoid_benchmarks.building.drive import Drive, Image
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.virtual_mapper import Delay
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building
from hoid_benchmarks.building.world.route import (
    CORNER,
    FULL_TURN,
    RATE_HZ,
    SPEED_MPS,
    Route,
    first_mark,
    stamps_ns,
)
from hoid_common.values import NS_PER_S

CONSTANT_S = (1.2, 2.5, 5.0)
SLOWDOWNS = (10.0, 20.0, 30.0)
"""Multiples of its own CPU time that a slow mapper needs for a keyframe."""
SPEEDS_MPS = (0.5, 0.8)
STALLS_S = (2.0, 4.0, 8.0)
ATTACHED_POINTS = 100
"""Map points that an image must track to be attached to the map."""
_HELD_S = 1.0  # an image is re-attached if all images of the next second are attached too
_LOOP_IMAGES = 900
_COLUMNS = {
    'route': '',
    'm/s': '.1f',
    'delay': '',
    're-attached after s': '.1f',
    'longest detached s': '.1f',
    'false joins': 'd',
    'joins without a loop': 'd',
    'joins': 'd',
    'lost': 'd',
    'keyframes': 'd',
    'rigid to': '.0e',
    'ATE mm': '.1f',
    'ratio': '.2f',
}


class _Course(NamedTuple):
    """A route, and the image at which a stall begins."""

    name: str
    speed_mps: float
    route: Route
    stall_at: int
    num_images: int


def lag(
    seed: int,
    constant_s: Sequence[float] = CONSTANT_S,
    slowdowns: Sequence[float] = SLOWDOWNS,
    stalls_s: Sequence[float] = STALLS_S,
    only: Sequence[str] = ('loop', CORNER, FULL_TURN),
) -> Outcome:
    """Return attachment, joins and errors for each delay.

    Args:
        seed: Seed of building, route and camera.
        constant_s: Constant delays, driven on the route `loop` at both speeds.
        slowdowns: Factors on the mapper's own CPU time, driven on the same routes.
        stalls_s: Single stalls, driven on the routes `corner` and `full turn`.
        only: Routes to drive.
    """
    building = Building(seed=seed)
    rows: list[dict[str, Any]] = []
    for course in _courses(building):
        if course.name not in only:
            continue
        start_s = float(stamps_ns(course.stall_at + 1)[-1]) / NS_PER_S
        delays = [Delay()]
        if course.name == 'loop':
            delays += [Delay(constant_s=s) for s in constant_s]
            delays += [Delay(cpu_factor=factor) for factor in slowdowns]
        else:
            delays += [Delay(stall_s=s, stall_at_s=start_s) for s in stalls_s]
        undelayed_m = None
        for delay in delays:
            row = _drive(building, course, delay, seed)
            undelayed_m = undelayed_m or row['ATE mm']
            rows.append(row | {'ratio': row['ATE mm'] / undelayed_m})
    return Outcome('lag', 'A late mapper', _COLUMNS, rows)


def _courses(building: Building) -> Iterator[_Course]:
    for speed_mps in SPEEDS_MPS:
        loop = Route(building, speed_mps=speed_mps)
        loop.around(1, 1, rooms=1, every=2)
        yield _Course('loop', speed_mps, loop, 0, min(_LOOP_IMAGES, len(loop)))
    corner = Route(building, yaw_rad=np.pi / 2)
    corner.to_junction(0, 1)
    corner.to_junction(1, 1)
    yield _Course(CORNER, SPEED_MPS, corner, first_mark(corner.marks, CORNER), len(corner))
    turn = Route(building)
    turn.to_junction(1, 0, rooms=1)
    yield _Course(FULL_TURN, SPEED_MPS, turn, first_mark(turn.marks, FULL_TURN), len(turn))


def _drive(building: Building, course: _Course, delay: Delay, seed: int) -> dict[str, Any]:
    truth = course.route.trajectory(seed)
    with Drive(FeatureCamera(building, seed), truth, delay) as drive:
        drive.run(0, course.num_images)
        drive.session.map.finish()
        stalled = next((a.answer_s for a in drive.worker.answers if a.is_stalled), None)
        return {
            'route': course.name,
            'm/s': course.speed_mps,
            'delay': _delay_text(delay),
            're-attached after s': None
            if stalled is None
            else reattached_s(drive.images, stalled),
            'longest detached s': longest_detached_s(drive.images),
            'false joins': drive.num_false_joins,
            'joins without a loop': sum(not join.has_left for join in drive.joins),
            'joins': len(drive.joins),
            'keyframes': drive.num_keyframes,
            'ATE mm': 1e3 * drive.ate_m(),
            'ATE online mm': 1e3 * drive.ate_m('online'),
            'tracked': [image.num_tracked for image in drive.images],
            'lost': drive.num_lost,
            'rigid to': drive.rigid_error(),
            'join list': [join._asdict() for join in drive.joins],
        }


def reattached_s(images: Sequence[Image], answer_s: float) -> float:
    """Return the time [s] from an answer until the camera is attached to the map; inf for never.

    It has to stay attached for a second.
    """
    attached = np.array([image.num_tracked >= ATTACHED_POINTS for image in images])
    hold = int(_HELD_S * RATE_HZ)
    for n, image in enumerate(images):
        if image.stamp_s >= answer_s and attached[n : n + hold].all():
            return image.stamp_s - answer_s
    return np.inf


def longest_detached_s(images: Sequence[Image]) -> float:
    """Return the longest time [s] in which every image tracks too few map points."""
    longest = run = 0
    for image in images:
        run = run + 1 if image.num_tracked < ATTACHED_POINTS else 0
        longest = max(longest, run)
    return longest / RATE_HZ


def _delay_text(delay: Delay) -> str:
    if delay.constant_s:
        return f'constant {delay.constant_s:g} s'
    if delay.cpu_factor:
        return f'{delay.cpu_factor:g} times too slow'
    return f'stall {delay.stall_s:g} s' if delay.stall_s else 'none'
