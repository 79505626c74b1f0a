"""The event `take_chair`: a person comes, sits down on a chair, rises, and leaves with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.acting import BodyTrack, ObjectTrack, ease
from hoid_synth.acting.camera_path import FRONT_Y_M
from hoid_synth.acting.script import PersonMotion, walk_along
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.people.body import Build
from hoid_synth.people.gait import standing_height
from hoid_synth.room.layout import WIDTHS_M
from hoid_synth.room.world import upright_poses

# Relative to the chair; both are out of view.
_COMES_FROM_M, _LEAVES_TO_M = np.array([[1.4, 0.0], [-1.9, 0.0]])
_WALK_MPS = 0.9
_TURN_S, _SIT_DOWN_S, _SEATED_S, _LIFT_S = 0.5, 0.8, 1.2, 0.6
_CHAIR_AHEAD_M = 0.42  # ahead of its carrier, and behind a person who sits on it
_LIFTED_M = 0.35
_PELVIS_M, _PELVIS_BACK_M = 0.57, 0.32  # of a seated person: above the floor, behind the feet
_GRIP_M = np.array([[0.21, -0.05, 0.46], [-0.21, -0.05, 0.46]])  # on both sides of the seat
_RISING_LEAN_RAD, _GRIP_LEAN_RAD, _GRIP_DROP_M = 1.3, 0.7, 0.25


class Seat(NamedTuple):
    """Place of the chair, motion of the person, and first frames of the actions."""

    chair_m: FloatArray  # (2,) on the floor; its front is towards the camera
    motion: PersonMotion
    sits: int  # sitting down begins
    rises: int  # rising begins
    takes: int  # bending down to the chair begins
    grips: int  # the chair is in the hands
    leaves: int  # the chair is lifted


def seat_motion(config: SceneConfig) -> Seat:
    """Return the plan of the event; at its end the person stands out of view."""
    chair = np.array([WIDTHS_M[0] / 2, FRONT_Y_M + config.near_m])
    before = chair - [0.0, _CHAIR_AHEAD_M]
    turn, sit_down, seated, lift = (
        round(s * FRAME_RATE_HZ) for s in (_TURN_S, _SIT_DOWN_S, _SEATED_S, _LIFT_S)
    )
    come, coming = walk_along(np.stack([before + _COMES_FROM_M, before]), _WALK_MPS)
    go, going = walk_along(np.stack([before, before + _LEAVES_TO_M]), _WALK_MPS)
    away, camera, to_chair = np.pi * np.array([1.0, 1.5, 2.5])  # all turns are to the left
    headings = [
        coming,
        np.linspace(away, camera, turn),
        np.full(2 * sit_down + seated, camera),
        np.linspace(camera, to_chair, turn),
        np.full(2 * lift, to_chair),
        np.linspace(to_chair, 3 * np.pi, turn),
        going + 2 * np.pi,
    ]
    heading = np.concatenate(headings)
    ends = np.cumsum([len(motion) for motion in headings])
    still = np.tile(before, (len(heading) - len(come) - len(go), 1))
    xy = np.concatenate([come, still, go])
    after = max(config.timeline_length - len(xy), 0)
    motion = PersonMotion(
        np.concatenate([xy, np.tile(xy[-1], (after, 1))]),
        np.concatenate([heading, np.full(after, heading[-1])]),
    )
    return Seat(chair, motion, ends[1], ends[2] - sit_down, ends[3], ends[3] + lift, ends[4])


def sit_and_take(seat: Seat, body: BodyTrack, build: Build) -> ObjectTrack:
    """Set lean, pelvis and hands of the body; return the track of the chair."""
    i = np.arange(len(body.xy_m))
    sit_down = round(_SIT_DOWN_S * FRAME_RATE_HZ)
    sits = ease(i, seat.sits, seat.sits + sit_down)
    sits *= 1 - ease(i, seat.rises, seat.rises + sit_down)
    bends = ease(i, seat.takes, seat.grips) * (1 - ease(i, seat.grips, seat.leaves))
    body.drop_m += sits * (standing_height(build) - _PELVIS_M) + bends * _GRIP_DROP_M
    body.back_m += sits * _PELVIS_BACK_M
    body.lean_rad += sits * (1 - sits) * _RISING_LEAN_RAD + bends * _GRIP_LEAN_RAD

    held = i >= seat.grips
    ahead = np.stack([np.cos(body.heading_rad), np.sin(body.heading_rad)], -1)
    T = upright_poses(
        np.where(held[:, None], body.xy_m + _CHAIR_AHEAD_M * ahead, seat.chair_m),
        _LIFTED_M * ease(i, seat.grips, seat.leaves),
        # The back of the chair points away from its carrier; yaw 0 is a heading of 90 degrees.
        np.where(held, body.heading_rad - np.pi / 2, 0.0),
    )
    body.hands_m[:] = np.einsum('nij,hj->nhi', T[:, :3, :3], _GRIP_M) + T[:, None, :3, 3]
    body.reach[:] = ease(i, seat.takes, seat.grips)[:, None]
    return ObjectTrack(T, held, np.where(held, 0, -1))
