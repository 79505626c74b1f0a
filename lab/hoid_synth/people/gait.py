"""Joints of a person who walks, bends and grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.people.body import Build, Joints

STRIDE_PER_HEIGHT = 0.7  # distance walked per gait cycle of two steps, divided by the body height
_STANCE = 0.6  # share of the gait cycle with the foot on the ground
_ANKLE_M = 0.085


@dataclass(frozen=True, eq=False)
class Stance:
    """Position and posture of a body at one time."""

    position_m: FloatArray  # (2,) on the floor
    heading_rad: float
    walked_m: float  # distance walked so far, which determines the phase of the gait
    stride: float  # 0 = standing to 1 = full steps
    lean_rad: float  # of the torso, forward
    drop_m: float  # lowering of the pelvis by bent knees
    back_m: float  # of the pelvis behind the feet, when seated
    gaze_rad: float  # of the head, to the left
    hands_m: FloatArray  # (2, 3) targets of the right and left palm
    reach: FloatArray  # (2,) 0 = hand free to 1 = hand at its target


def standing_height(build: Build) -> float:
    """Return the height of the pelvis above the floor of a standing person in m."""
    return build.leg_m * 0.985 + _ANKLE_M


def joints(at: Stance, build: Build) -> Joints:
    """Return the joints of a stance."""
    up = np.array([0.0, 0.0, 1.0])
    c, s = np.cos(at.heading_rad), np.sin(at.heading_rad)
    forward, right = np.array([c, s, 0]), np.array([s, -c, 0])
    sides = np.stack([right, -right])
    cycle = at.walked_m / (STRIDE_PER_HEIGHT * build.height_m)
    bob = 0.018 * at.stride * np.cos(4 * np.pi * cycle)
    sway = 0.02 * at.stride * np.sin(2 * np.pi * cycle)
    root = np.array([*at.position_m, 0.0])
    height = standing_height(build) - at.drop_m - 0.05 * at.stride + bob
    pelvis = (
        root
        + height * up
        + sway * right
        - (0.22 * at.drop_m + at.back_m) * forward
        - 0.1 * at.lean_rad * forward
    )
    spine = np.cos(at.lean_rad) * up + np.sin(at.lean_rad) * forward
    neck = pelvis + build.torso_m * spine
    twist = 0.05 * at.stride * np.cos(2 * np.pi * cycle)
    across = sides + np.array([[twist], [-twist]]) * forward
    shoulders = neck - 0.045 * spine + 0.108 * build.height_m * across * 1.04
    hips = (
        pelvis
        + 0.052 * build.height_m * (sides - 0.5 * np.array([[twist], [-twist]]) * forward)
        - 0.02 * up
    )
    ankles, toes = _feet(at, build, root, forward, sides, cycle)
    wrists = _wrists(at, build, shoulders, forward, sides, cycle)
    elbow_pole = -0.7 * up - 0.35 * forward + 0.45 * sides
    head = neck + 0.04 * spine + 0.08 * build.height_m * (0.5 * spine + 0.5 * up) + 0.02 * forward
    return Joints(
        forward,
        pelvis,
        neck,
        head,
        _head_pose(at, head),
        shoulders,
        _middle(shoulders, wrists, build.arm_m / 2, elbow_pole),
        wrists,
        hips,
        _middle(hips, ankles, build.leg_m / 2, np.stack([forward, forward])),
        ankles,
        toes,
    )


def _feet(
    at: Stance,
    build: Build,
    root: FloatArray,
    forward: FloatArray,
    sides: FloatArray,
    cycle: float,
) -> tuple[FloatArray, FloatArray]:
    phase = np.mod(cycle + np.array([0.0, 0.5]), 1.0)
    length = STRIDE_PER_HEIGHT * build.height_m * _STANCE / 2
    swing = np.clip((phase - _STANCE) / (1 - _STANCE), 0, 1)
    eased = swing * swing * (3 - 2 * swing)
    ahead = np.where(phase < _STANCE, 1 - 2 * phase / _STANCE, 2 * eased - 1) * length * at.stride
    lift = at.stride * 0.1 * np.sin(np.pi * swing)
    # Lift of the heel.
    heel = at.stride * (0.05 * np.clip((phase - 0.4) / 0.2, 0, 1) * (1 - swing))
    ankles = root + ahead[:, None] * forward + 0.05 * build.height_m * sides
    ankles = ankles + (_ANKLE_M + lift + heel)[:, None] * np.array([0, 0, 1.0])
    pitch = at.stride * (0.25 * np.sin(np.pi * swing) - 6 * heel)
    toes = ankles + 0.145 * (forward + pitch[:, None] * np.array([0, 0, 1.0]) + 0.18 * sides)
    return ankles, toes


def _wrists(
    at: Stance,
    build: Build,
    shoulders: FloatArray,
    forward: FloatArray,
    sides: FloatArray,
    cycle: float,
) -> FloatArray:
    swing = (
        at.stride * 0.42 * np.cos(2 * np.pi * cycle + np.array([np.pi, 0.0]))
        + 0.08
        + 0.5 * at.lean_rad
    )
    length = build.arm_m * 0.965
    hang = shoulders + length * (
        np.sin(swing)[:, None] * forward - np.cos(swing)[:, None] * np.array([0, 0, 1.0])
    )
    hang = hang + 0.07 * sides
    way = at.hands_m - shoulders
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    palm = 0.07 * way / np.maximum(distance, 1e-6)
    return np.asarray(hang + at.reach[:, None] * (at.hands_m - palm - hang))


def _head_pose(at: Stance, head: FloatArray) -> FloatArray:
    yaw = at.heading_rad + at.gaze_rad + np.pi / 2  # the face looks along -y
    pitch = 0.45 * at.lean_rad
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    cp, sp = np.cos(pitch), np.sin(pitch)
    T[:3, :3] = turn @ np.array([[1.0, 0, 0], [0, cp, -sp], [0, sp, cp]])
    T[:3, 3] = head
    return T


def _middle(start: FloatArray, end: FloatArray, link_m: float, pole: FloatArray) -> FloatArray:
    """Return the elbows or knees (2, 3) between two equal links; straight if out of reach."""
    way = end - start
    square = np.einsum('ij,ij->i', way, way)[:, None]
    across = pole - way * np.einsum('ij,ij->i', pole, way)[:, None] / np.maximum(square, 1e-9)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    return np.asarray(start + way / 2 + np.sqrt(np.maximum(link_m**2 - square / 4, 0)) * across)
