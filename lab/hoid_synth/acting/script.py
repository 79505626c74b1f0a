"""Planned motions of people: walking, standing, and carrying objects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.routes import FloorMap
from hoid_synth.config import FRAME_RATE_HZ
from hoid_synth.mesh import Rect
from hoid_synth.noise import Rng
from hoid_synth.room.world import PlacedProp, Spot, World

GRASP_S = 1.5  # duration of taking an object: bending down, gripping, rising; also of the reverse
CONTACT = 0.45  # share of GRASP_S before the hand holds the object
_ACCELERATION_S = 0.45
_TURN_S = 0.4
_SPEED_MPS = (0.85, 1.25)
_STAND_S = (3.1, 4.2)
_CANDIDATES = 14
_ROLES = (('fetch', 'walk', 'fetch', 'stand'), ('stand', 'fetch', 'walk', 'fetch'))
_CAMERA_CLEARANCE_M = 0.95
_PEOPLE_CLEARANCE_M = 0.7
_UNTOUCHED = 3  # objects that nobody touches


@dataclass(frozen=True)
class Handling:
    """A person's plan to take an object at one spot and put it down at another."""

    prop: int
    source: Spot
    target: Spot
    take_frame: int  # frame in which the carrier begins to bend down
    put_frame: int  # frame in which putting down begins; may lie after the end of the recording


@dataclass(eq=False)
class PersonMotion:
    """Motion of one person on the floor; the arrays grow while it is planned."""

    xy_m: FloatArray  # (N, 2)
    heading_rad: FloatArray  # (N,), with steps where the person turns on the spot
    handlings: list[Handling] = field(default_factory=list)
    # First and end frames of long stops.
    standing: list[tuple[int, int]] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Action:
    """A candidate for the next action of a person."""

    xy_m: FloatArray
    heading_rad: FloatArray
    handling: Handling | None = None
    standing: tuple[int, int] | None = None
    cost: float = 0.0


class MotionPlanner:
    """Plans the motions of people, action by action, apart from each other and the camera."""

    def __init__(
        self,
        world: World,
        T_world_camera: FloatArray,
        rng: Rng,
        keep_out: tuple[Rect, ...],
        near_m: float,
    ) -> None:
        self._world, self._camera, self._rng, self._near_m = world, T_world_camera, rng, near_m
        self._floor = FloorMap(world, keep_out)
        count = max(0, len(world.props) - _UNTOUCHED)
        self._free_props = {int(k) for k in rng.permutation(len(world.props))[:count]}
        self._prop_spots = {k: p.spot for k, p in enumerate(world.props)}
        self._free_spots = list(world.spots)
        # End frame, object, spot that becomes free then.
        self._busy: list[tuple[int, int, Spot]] = []

    def plan(self, num_people: int) -> list[PersonMotion]:
        """Return the motions of all people."""
        motions = [PersonMotion(np.empty((0, 2)), np.empty(0)) for _ in range(num_people)]
        counts = [0] * num_people
        total = len(self._camera)
        while motions:
            k = min(range(num_people), key=lambda n: len(motions[n].xy_m))
            if len(motions[k].xy_m) >= total:
                break
            roles = _ROLES[k % len(_ROLES)]
            self._append_action(roles[counts[k] % len(roles)], motions, k)
            counts[k] += 1
        return motions

    def _append_action(self, role: str, motions: list[PersonMotion], k: int) -> None:
        motion, frame = motions[k], len(motions[k].xy_m)
        self._release(frame)
        draws = [self._draw(role, motion) for _ in range(_CANDIDATES)]
        others = [p for n, p in enumerate(motions) if n != k]
        best = min(draws, key=lambda action: self._cost(action, frame, others))
        motion.xy_m = np.concatenate([motion.xy_m, best.xy_m])
        motion.heading_rad = np.concatenate([motion.heading_rad, best.heading_rad])
        if best.standing is not None:
            motion.standing.append(best.standing)
        if best.handling is not None:
            self._reserve(motion, best.handling)

    def _reserve(self, motion: PersonMotion, handling: Handling) -> None:
        motion.handlings.append(handling)
        self._free_props.discard(handling.prop)
        self._free_spots.remove(handling.target)
        self._prop_spots[handling.prop] = handling.target
        self._busy.append((len(motion.xy_m), handling.prop, handling.source))

    def _release(self, frame: int) -> None:
        for entry in [b for b in self._busy if b[0] <= frame]:
            self._busy.remove(entry)
            self._free_props.add(entry[1])
            self._free_spots.append(entry[2])

    def _draw(self, role: str, motion: PersonMotion) -> _Action:
        if role == 'fetch':
            action = self._draw_fetch(motion)
            if action is not None:
                return action
        return self._draw_walk(motion, stand=role == 'stand')

    def _start(
        self, motion: PersonMotion, near_m: tuple[float, float] | None
    ) -> tuple[float, float]:
        """Return the current position (x, y) in m; a new person starts near `near_m`."""
        if len(motion.xy_m):
            x, y = motion.xy_m[-1]
            return float(x), float(y)
        for _ in range(50):
            at = self._somewhere()
            if near_m is None or 0.4 < np.hypot(at[0] - near_m[0], at[1] - near_m[1]) < 1.6:
                return at
        return near_m or self._somewhere()

    def _somewhere(self) -> tuple[float, float]:
        while True:
            room = self._world.rooms[int(self._rng.integers(0, len(self._world.rooms)))]
            at = self._rng.uniform(room[:2], room[2:])
            if self._floor.is_free(at):
                return float(at[0]), float(at[1])

    def _draw_walk(self, motion: PersonMotion, stand: bool) -> _Action:
        rng, frame = self._rng, len(motion.xy_m)
        end = self._somewhere()
        start = self._start(motion, end if stand else None)
        xy, heading = self._walk(start, end, ())
        if not stand:
            return _Action(xy, heading)
        stay = round(rng.uniform(*_STAND_S) * FRAME_RATE_HZ)
        first = frame + len(xy)
        facing = float(rng.uniform(-np.pi, np.pi))
        if frame < len(self._camera) and rng.random() < 0.6:
            way = self._camera[min(first, len(self._camera) - 1), :2, 3] - np.array(end)
            facing = float(np.arctan2(way[1], way[0]))
        xy = np.concatenate([xy, np.tile(end, (stay, 1))])
        return _Action(
            xy, np.concatenate([heading, np.full(stay, facing)]), None, (first, first + stay)
        )

    def _draw_fetch(self, motion: PersonMotion) -> _Action | None:
        rng, frame = self._rng, len(motion.xy_m)
        if not self._free_props:
            return None
        k = sorted(self._free_props)[int(rng.integers(0, len(self._free_props)))]
        prop = self._world.props[k].prop
        targets = [s for s in self._free_spots if s.on_floor == prop.on_floor]
        if not targets:
            return None
        source, target = self._prop_spots[k], targets[int(rng.integers(0, len(targets)))]
        around = self._resting(k)
        grasp = round(GRASP_S * FRAME_RATE_HZ)
        to, heading = self._walk(self._start(motion, source.stand_m), source.stand_m, around)
        carry, carry_heading = self._walk(source.stand_m, target.stand_m, around)
        xy = np.concatenate(
            [
                to,
                np.tile(source.stand_m, (grasp, 1)),
                carry,
                np.tile(target.stand_m, (grasp, 1)),
            ]
        )
        headings = np.concatenate(
            [
                heading,
                np.full(grasp, source.heading_rad),
                carry_heading,
                np.full(grasp, target.heading_rad),
            ]
        )
        take = frame + len(to)
        return _Action(xy, headings, Handling(k, source, target, take, take + grasp + len(carry)))

    def _resting(self, but: int) -> list[Rect]:
        rects = []
        for k, placed in enumerate(self._world.props):
            if k != but and placed.prop.on_floor:
                rects.append(_square(self._prop_spots[k], placed))
        return rects

    def _walk(
        self,
        start_m: tuple[float, float],
        end_m: tuple[float, float],
        around: list[Rect] | tuple[()],
    ) -> tuple[FloatArray, FloatArray]:
        points = self._floor.route(start_m, end_m, around)
        return walk_along(points, float(self._rng.uniform(*_SPEED_MPS)))

    def _cost(self, action: _Action, frame: int, others: list[PersonMotion]) -> float:
        """Return the cost of an action: proximity, being out of view, and duration."""
        frames = np.minimum(np.arange(frame, frame + len(action.xy_m)), len(self._camera) - 1)
        T = self._camera[frames]
        way = action.xy_m - T[:, :2, 3]
        distance = np.linalg.norm(way, axis=1)
        cost = 30 * float(np.maximum(_CAMERA_CLEARANCE_M - distance, 0).sum())
        for other in others:
            if len(other.xy_m) == 0:
                continue
            theirs = other.xy_m[np.minimum(frames, len(other.xy_m) - 1)]
            gap = np.linalg.norm(action.xy_m - theirs, axis=1)
            cost += 20 * float(np.maximum(_PEOPLE_CLEARANCE_M - gap, 0).sum())
        ahead = np.einsum('ij,ij->i', way, T[:, :2, 2]) / np.maximum(distance, 1e-6)
        seen = ahead > np.cos(np.radians(27))
        share = np.minimum(self._near_m / np.maximum(distance, 1e-6), 1) ** 2
        return cost - 12 * float((seen * share).mean()) + 0.004 * len(action.xy_m)


def _square(spot: Spot, placed: PlacedProp) -> Rect:
    (x, y, _), r = spot.position_m, placed.prop.radius_m
    return x - r, y - r, x + r, y + r


def walk_along(points_m: FloatArray, speed_mps: float) -> tuple[FloatArray, FloatArray]:
    """Return positions (N, 2) and headings (N,) at the frame rate of a walk along points."""
    if len(points_m) < 2:
        return np.empty((0, 2)), np.empty(0)
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
    duration = s[-1] / speed_mps + _ACCELERATION_S
    count = max(2, round((duration + _TURN_S) * FRAME_RATE_HZ))
    t = np.arange(count) / FRAME_RATE_HZ - _TURN_S  # the person turns before walking
    ramp = np.clip(np.minimum(t, duration - t) / _ACCELERATION_S, 0, 1)
    walked = np.cumsum(ramp * ramp * (3 - 2 * ramp))
    walked *= s[-1] / max(walked[-1], 1e-9)
    xy = np.stack([np.interp(walked, s, points_m[:, k]) for k in range(2)], -1)
    ahead, behind = np.minimum(walked + 0.15, s[-1]), np.maximum(walked - 0.15, 0)
    way = [
        np.interp(ahead, s, points_m[:, k]) - np.interp(behind, s, points_m[:, k])
        for k in range(2)
    ]
    return xy, np.arctan2(way[1], way[0])
