"""Body stances and object poses of every frame, from the planned motions of people."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_synth.acting.script import CONTACT, GRASP_S, Handling, PersonMotion
from hoid_synth.config import FRAME_RATE_HZ
from hoid_synth.noise import Rng
from hoid_synth.people.gait import Stance
from hoid_synth.room.props import Prop
from hoid_synth.room.world import Spot, World, pose, resting_yaw, upright_poses

_GRASP_FRAMES = round(GRASP_S * FRAME_RATE_HZ)
_HOLD_FRAMES = round(GRASP_S * FRAME_RATE_HZ * CONTACT)
_FULL_STRIDE_MPS = 0.7


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """Pose of one movable object, and the person who holds it, in every frame."""

    T_world_object: FloatArray  # (N, 4, 4)
    handled: BoolArray  # (N,) whether a person holds the object
    holder: IntArray  # (N,) index of the person who holds the object; -1 for nobody

    def at(self, frames: IntArray) -> ObjectTrack:
        """Return the track with the given frames (M,) only."""
        return ObjectTrack(*(getattr(self, f.name)[frames] for f in fields(self)))


@dataclass(eq=False)
class BodyTrack:
    """Stance of one person in every frame."""

    xy_m: FloatArray  # (N, 2)
    heading_rad: FloatArray  # (N,)
    walked_m: FloatArray
    stride: FloatArray
    lean_rad: FloatArray
    drop_m: FloatArray
    back_m: FloatArray
    gaze_rad: FloatArray
    hands_m: FloatArray  # (N, 2, 3)
    reach: FloatArray  # (N, 2)

    def stance(self, i: int) -> Stance:
        """Return the stance in frame i."""
        return Stance(
            self.xy_m[i],
            float(self.heading_rad[i]),
            float(self.walked_m[i]),
            float(self.stride[i]),
            float(self.lean_rad[i]),
            float(self.drop_m[i]),
            float(self.back_m[i]),
            float(self.gaze_rad[i]),
            self.hands_m[i],
            self.reach[i],
        )

    def at(self, frames: IntArray) -> BodyTrack:
        """Return the track of the given frames (M,); where one repeats, the person stands."""
        track = BodyTrack(*(getattr(self, f.name)[frames] for f in fields(self)))
        moves = np.diff(frames, append=frames[-1] + 1) > 0
        if not moves.all():
            track.stride = track.stride * _smoothed(moves.astype(float), 9)
        return track


def body_track(motion: PersonMotion, count: int, rng: Rng) -> BodyTrack:
    """Return the track of a person who walks and stands, without reaching for objects."""
    xy, heading = motion.xy_m[:count], np.unwrap(motion.heading_rad[:count])
    xy = _smoothed(xy, 7)
    step = np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=1)
    speed = _smoothed(step * FRAME_RATE_HZ, 9)
    t = np.arange(count) / FRAME_RATE_HZ
    gaze = 0.3 * np.sin(2 * np.pi * t[:, None] * [0.11, 0.23] + rng.uniform(0, 6, 2)).sum(1)
    zeros = np.zeros(count)
    return BodyTrack(
        xy,
        _smoothed(heading, 15),
        np.cumsum(step) + rng.uniform(0, 2),
        np.clip(speed / _FULL_STRIDE_MPS, 0, 1),
        zeros.copy(),
        zeros.copy(),
        zeros.copy(),
        gaze,
        np.zeros((count, 2, 3)),
        np.zeros((count, 2)),
    )


def _smoothed(values: FloatArray, width: int) -> FloatArray:
    """Return values filtered by a Hann window along time."""
    kernel = np.hanning(width + 2)[1:-1]
    kernel /= kernel.sum()
    half = width // 2
    columns = values.reshape(len(values), -1)
    padded = np.pad(columns, ((half, half), (0, 0)), 'edge')
    out = np.stack([np.convolve(c, kernel, 'valid') for c in padded.T], -1)
    return out.reshape(values.shape)


def object_tracks(
    world: World, motions: list[PersonMotion], bodies: list[BodyTrack], count: int
) -> list[ObjectTrack]:
    """Return the track of every object; also set lean and hands of the bodies that carry them."""
    tracks = []
    for k, placed in enumerate(world.props):
        T = np.tile(pose(*placed.spot.position_m, placed.yaw_rad), (count, 1, 1))
        track = ObjectTrack(T, np.zeros(count, bool), np.full(count, -1))
        own = [(h, n) for n, motion in enumerate(motions) for h in motion.handlings if h.prop == k]
        yaw = placed.yaw_rad
        for handling, n in sorted(own, key=lambda item: item[0].take_frame):
            yaw = _handle(placed.prop, handling, yaw, bodies[n], n, track)
        tracks.append(track)
    return tracks


def ease(frames: IntArray, start: float, end: float) -> FloatArray:
    """Return a smooth step (N,) from 0 at `start` to 1 at `end`."""
    x = np.clip((frames - start) / max(end - start, 1e-9), 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def _handle(
    prop: Prop, h: Handling, yaw_rad: float, body: BodyTrack, n: int, track: ObjectTrack
) -> float:
    """Set object and body tracks while a person carries the object; return the yaw put down."""
    count = len(track.handled)
    i = np.arange(count)
    grip, release = h.take_frame + _HOLD_FRAMES, h.put_frame + _GRASP_FRAMES - _HOLD_FRAMES
    new_yaw = resting_yaw(prop, h.target)
    lifted = ease(i, grip, h.take_frame + _GRASP_FRAMES) * (1 - ease(i, h.put_frame, release))
    carried = _carried(prop, body)
    before = i < (h.take_frame + h.put_frame) / 2
    rest_at = np.where(before[:, None], h.source.position_m, h.target.position_m)
    rest_yaw = np.where(before, yaw_rad, new_yaw)
    turn = np.mod(carried[:, 3] - rest_yaw + np.pi, 2 * np.pi) - np.pi
    at = rest_at + lifted[:, None] * (carried[:, :3] - rest_at)
    moved = upright_poses(at[:, :2], at[:, 2], rest_yaw + lifted * turn)
    here = i >= h.take_frame
    track.T_world_object[here] = moved[here]
    held = (i >= grip) & (i < release)
    track.handled[held] = True
    track.holder[held] = n
    _bend(body, prop, h, i)
    _reach(body, prop, h, track.T_world_object, i, grip, release)
    return new_yaw


def _carried(prop: Prop, body: BodyTrack) -> FloatArray:
    """Return x, y, z and yaw (N, 4) of the object while it is carried."""
    right, ahead, up = prop.hold_m
    c, s = np.cos(body.heading_rad), np.sin(body.heading_rad)
    x = body.xy_m[:, 0] + ahead * c + right * s
    y = body.xy_m[:, 1] + ahead * s - right * c
    z = up + 0.012 * body.stride * np.cos(4 * np.pi * body.walked_m / 1.22)
    return np.stack([x, y, z, body.heading_rad - np.pi / 2 + prop.hold_yaw_rad], -1)


def _bend(body: BodyTrack, prop: Prop, h: Handling, i: IntArray) -> None:
    """Bend the body down to the grip of the object, where it is taken and put down."""
    held = _HOLD_FRAMES
    spots: list[tuple[Spot, int, int]] = [
        (h.source, h.take_frame, h.take_frame + held),
        (h.target, h.put_frame, h.put_frame + _GRASP_FRAMES - held),
    ]
    for spot, start, low in spots:
        end = start + _GRASP_FRAMES
        weight = ease(i, start, low) * (1 - ease(i, low, end))
        height = spot.position_m[2] + prop.grip_m[2]
        body.lean_rad += weight * np.clip(1.2 - height, 0.12, 1.1)
        body.drop_m += weight * np.clip(0.6 * (0.9 - height), 0, 0.46)


def _reach(
    body: BodyTrack, prop: Prop, h: Handling, T: FloatArray, i: IntArray, grip: int, release: int
) -> None:
    """Move the hands to the object before the grip, and away from it after the release."""
    weight = ease(i, h.take_frame, grip) * (1 - ease(i, release, release + 10))
    used = (i >= h.take_frame) & (i < release + 10)
    mirrored = np.array([-1.0, 1.0, 1.0])
    grips = np.array([prop.grip_m, prop.grip_m * mirrored])
    for hand in range(2 if prop.two_handed else 1):
        at = T[:, :3, :3] @ grips[hand] + T[:, :3, 3]
        body.hands_m[used, hand] = at[used]
        body.reach[used, hand] = weight[used]
