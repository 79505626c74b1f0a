"""People on a floor: some walk in the corridors, others are in the room that the robot visits.

Such a person is in another room as soon as the robot has left, because a person that nobody sees
costs as much time to render as one in view. With two of them, the next one waits in time.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.acting import BodyTrack, body_track
from hoid_synth.acting.script import MotionPlanner, PersonMotion
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.floor.plan import FloorRoom, floor_plan
from hoid_synth.floor.route import INTO_ROOM_M, Visit, floor_route
from hoid_synth.mesh import Rect
from hoid_synth.noise import Rng
from hoid_synth.room.world import World

_BESIDE_ROBOT_M = 0.8  # half width of the floor that people leave to the robot in a room


class _Stay(NamedTuple):
    """A part of the timeline that a person spends in one place."""

    first: int
    last: int
    zone: Rect
    keep_out: tuple[Rect, ...]


def floor_people(
    config: SceneConfig, world: World, T_world_camera: FloatArray, rng: Rng
) -> tuple[list[PersonMotion], list[BodyTrack]]:
    """Return motions and tracks of all people over the timeline of camera poses (N, 4, 4)."""
    plan, count = floor_plan(config.num_rooms), len(T_world_camera)
    num_walkers = (config.num_people + 1) // 2
    num_hosts = config.num_people - num_walkers
    stays = [[_Stay(0, count, plan.main[k % len(plan.main)], ())] for k in range(num_walkers)] + [
        _stays_of_host(floor_route(config.num_rooms).visits[k::num_hosts], config, count)
        for k in range(num_hosts)
    ]
    motions, bodies = [], []
    for own in stays:
        parts = [_planned(stay, world, T_world_camera, rng, config.near_m) for stay in own]
        tracks = [
            body_track(part, stay.last - stay.first, rng)
            for part, stay in zip(parts, own, strict=True)
        ]
        motions.append(
            PersonMotion(
                np.concatenate([track.xy_m for track in tracks]),
                np.concatenate([track.heading_rad for track in tracks]),
            )
        )
        bodies.append(_joined(tracks))
    return motions, bodies


def _stays_of_host(visits: list[Visit], config: SceneConfig, count: int) -> list[_Stay]:
    """Return the stays of a person who is in the rooms of some visits when the robot comes."""
    stays, first = [], 0
    for n, visit in enumerate(visits):
        left = round((visit.last_s - config.start_s) * FRAME_RATE_HZ)
        last = count if n == len(visits) - 1 else min(max(left, 0), count)
        if last > first:
            stays.append(_Stay(first, last, visit.room.rect, (_robots_floor(visit.room),)))
            first = last
    return stays


def _robots_floor(room: FloorRoom) -> Rect:
    x, (_, y1, _, y2) = room.door_x_m, room.rect
    reach_m = INTO_ROOM_M + _BESIDE_ROBOT_M
    low = y2 - reach_m if room.is_door_north else y1
    return x - _BESIDE_ROBOT_M, low, x + _BESIDE_ROBOT_M, low + reach_m


def _planned(
    stay: _Stay, world: World, T_world_camera: FloatArray, rng: Rng, near_m: float
) -> PersonMotion:
    """Return the motion of one person in a zone, planned in coordinates of the zone."""
    x, y = stay.zone[:2]

    def local(rect: Rect) -> Rect:
        return rect[0] - x, rect[1] - y, rect[2] - x, rect[3] - y

    touched = [
        local(rect)
        for rect in world.obstacles
        if rect[0] < stay.zone[2] and rect[2] > x and rect[1] < stay.zone[3] and rect[3] > y
    ]
    part = replace(
        world, rooms=(local(stay.zone),), doorways=(), obstacles=tuple(touched), props=(), spots=()
    )
    T = T_world_camera[stay.first : stay.last].copy()
    T[:, :2, 3] -= (x, y)
    keep_out = tuple(local(rect) for rect in stay.keep_out)
    (motion,) = MotionPlanner(part, T, rng, keep_out, near_m).plan(1)
    motion.xy_m += np.array([x, y])
    return motion


def _joined(tracks: list[BodyTrack]) -> BodyTrack:
    columns = [
        np.concatenate([getattr(track, f.name) for track in tracks]) for f in fields(BodyTrack)
    ]
    return BodyTrack(*columns)
