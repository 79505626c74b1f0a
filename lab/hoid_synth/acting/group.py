"""A group that walks past the camera: one motion that can have more features than the room."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.camera_path import FRONT_Y_M
from hoid_synth.acting.script import GRASP_S, Handling, PersonMotion, walk_along
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.noise import Rng
from hoid_synth.room.props import Prop
from hoid_synth.room.world import PlacedProp, World

_SPEED_MPS = (0.75, 0.9)
_SPACING_M = (0.86, 0.94)  # along the path; less if the path of many people becomes too short
_LEAST_PATH_M = 1.2
_ROWS_APART_M = (0.15, 0.3)  # distance between two rows
_JITTER_M = 0.03
_TURN_S = 0.6  # at the ends of the path
_WALL_CLEARANCE_M = 0.6
_BODY_M = 0.2  # half the width of a body
_CARRYING = 0.5  # share of the people who carry an object


def group_motions(world: World, config: SceneConfig, rng: Rng) -> list[PersonMotion]:
    """Return the motions of people who walk with one velocity; some carry an object."""
    num, count = config.num_people, config.timeline_length
    margin_m = _WALL_CLEARANCE_M + _JITTER_M
    x1, x2 = world.rooms[0][0] + margin_m, world.rooms[0][2] - margin_m
    most_m = (x2 - x1 - _LEAST_PATH_M) / max(num - 1, 1)
    spacing_m = min(float(rng.uniform(*_SPACING_M)), most_m)
    places = _places(num, spacing_m, rng)[rng.permutation(num)]
    half_m, y = (num - 1) / 2 * spacing_m, FRONT_Y_M + config.near_m
    ends = np.array([[x1 + half_m, y], [x2 - half_m, y]])
    if rng.random() < 0.5:
        ends = ends[::-1]
    xy, heading = walk_to_and_fro(ends, float(rng.uniform(*_SPEED_MPS)), count)
    motions = [PersonMotion(xy + place, heading.copy()) for place in places]
    _hand_out(world.props, motions, min(spacing_m - _BODY_M, _WALL_CLEARANCE_M), rng)
    return motions


def _places(num: int, spacing_m: float, rng: Rng) -> FloatArray:
    """Return positions (num, 2) relative to the middle of the group, in two loose rows."""
    along = (np.arange(num) - (num - 1) / 2) * spacing_m
    farther = (np.arange(num) + rng.integers(0, 2)) % 2 - 0.5
    away = farther * float(rng.uniform(*_ROWS_APART_M))
    return np.stack([along, away], -1) + rng.uniform(-_JITTER_M, _JITTER_M, (num, 2))


def walk_to_and_fro(
    ends_m: FloatArray, speed_mps: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return at least `count` positions (N, 2) and headings (N,) between two ends (2, 2)."""
    turn = round(_TURN_S * FRAME_RATE_HZ)
    xy, heading = np.empty((0, 2)), np.empty(0)
    while len(xy) < count:
        walked, facing = walk_along(ends_m, speed_mps)
        turning = facing[-1] + np.linspace(0, np.pi, turn)
        xy = np.concatenate([xy, walked, np.tile(walked[-1], (turn, 1))])
        heading = np.concatenate([heading, facing, turning])
        ends_m = ends_m[::-1]
    return xy, heading


def _hand_out(
    props: tuple[PlacedProp, ...], motions: list[PersonMotion], reach_m: float, rng: Rng
) -> None:
    """Let some people carry an object that collides with nobody, from begin to end."""
    fitting = [k for k, placed in enumerate(props) if _reach_m(placed.prop) < reach_m]
    carriers = rng.permutation(len(motions))[: int(np.ceil(_CARRYING * len(motions)))]
    grasp = round(GRASP_S * FRAME_RATE_HZ)
    for n, k in zip(carriers, rng.permutation(fitting), strict=False):
        spot, motion = props[int(k)].spot, motions[int(n)]
        # Taken long before the recording and put down after it, so neither is visible.
        motion.handlings.append(Handling(int(k), spot, spot, -2 * grasp, len(motion.xy_m) + grasp))


def _reach_m(prop: Prop) -> float:
    """Return the extent of a carried object from the middle of its carrier in m."""
    c, s = np.cos(prop.hold_yaw_rad), np.sin(prop.hold_yaw_rad)
    across = prop.mesh.vertices_m[:, :2] @ np.array([[c, s], [-s, c]]) + prop.hold_m[:2]
    return float(np.linalg.norm(across, axis=1).max())
