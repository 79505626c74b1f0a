"""Motions of events: large objects that are carried past the camera or move by themselves."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.acting import BodyTrack, ObjectTrack
from hoid_synth.acting.camera_path import FRONT_Y_M
from hoid_synth.acting.group import walk_to_and_fro
from hoid_synth.acting.script import PersonMotion
from hoid_synth.acting.seat import seat_motion, sit_and_take
from hoid_synth.config import CARRIED, FRAME_RATE_HZ, PASSING_MPS, SceneConfig
from hoid_synth.noise import Rng
from hoid_synth.room.layout import WIDTHS_M
from hoid_synth.room.rooms import DEPTH_M
from hoid_synth.room.world import World, upright_poses

_MIDDLE_X_M = WIDTHS_M[0] / 2
_HALF_PATH_M = 1.9  # half the length of a path past the camera
_DOOR_PERIOD_S = 5.0
_FLOOR_SEEN_M = 0.9  # distance beyond the other events at which the camera sees the floor
_GRAVITY_MPS2 = 9.81
_SLIDE_M, _SLIDE_PERIOD_S = 0.25, 5.0


def carrier_motions(config: SceneConfig) -> list[PersonMotion]:
    """Return the motions of people who carry, pull or push an object past the camera."""
    if config.event == 'take_chair':
        return [seat_motion(config).motion]
    count, y = config.timeline_length, FRONT_Y_M + config.near_m
    if config.event == 'pull_door':
        angle = _door_angle(count)
        hinge = _hinge(config)
        hand = hinge + 1.1 * np.stack([np.cos(angle), np.sin(angle)], -1)
        behind = 0.2 * np.stack([-np.sin(angle), np.cos(angle)], -1)
        return [PersonMotion(hand + behind, angle - np.pi / 2)]
    ends = np.array([[_MIDDLE_X_M - _HALF_PATH_M, y], [_MIDDLE_X_M + _HALF_PATH_M, y]])
    xy, heading = _pass(config, ends)
    if config.event == 'carry_screen':  # a person at each end
        aside = np.array([0.8, 0.0])
        return [PersonMotion(xy + side * aside, heading.copy()) for side in (-1, 1)]
    return [PersonMotion(xy, heading)]


def mover_track(
    config: SceneConfig,
    world: World,
    motions: list[PersonMotion],
    bodies: list[BodyTrack],
    T_world_camera: FloatArray,
    rng: Rng,
) -> ObjectTrack:
    """Return the track of an event's object; also set the track of the body that takes it."""
    if config.event == 'take_chair':
        return sit_and_take(seat_motion(config), bodies[0], world.wardrobes[0].build)
    T, held = _mover_poses(config, motions, T_world_camera, rng), config.event in CARRIED
    return ObjectTrack(T, np.full(len(T), held), np.full(len(T), 0 if held else -1))


def _mover_poses(
    config: SceneConfig, motions: list[PersonMotion], T_world_camera: FloatArray, rng: Rng
) -> FloatArray:
    count = config.timeline_length
    if config.event.startswith('carry_'):
        middle = np.mean([motion.xy_m[:count] for motion in motions], axis=0)
        height = 0.25 if config.event == 'carry_chair' else 0.8
        nearer = np.array([0.0, -0.42])  # from the person who carries it towards the camera
        return upright_poses(middle + nearer, height, 0.0)
    if config.event == 'push_trolley':
        motion = motions[0]
        ahead = np.stack([np.cos(motion.heading_rad), np.sin(motion.heading_rad)], -1)[:count]
        xy = motion.xy_m[:count] + 0.75 * ahead
        return upright_poses(xy, 0.0, motion.heading_rad[:count])
    make = {
        'pull_door': _door, 'door': _door, 'robot': _drive, 'trolley': _drive, 'ball': _roll,
        'cat': _stroll, 'followed': _lead, 'picture': _fall, 'panel': _slide,
    }[config.event]  # fmt: skip
    return make(config, T_world_camera, rng)


def _pass(config: SceneConfig, ends_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (N, 2) and headings (N,) to and fro; a given speed shortens the path."""
    speed_mps = config.speed_mps or PASSING_MPS[config.event]
    if config.speed_mps:
        way = ends_m[1] - ends_m[0]
        walked_m = speed_mps * config.timeline_length / FRAME_RATE_HZ
        share = min(1.0, walked_m / float(np.linalg.norm(way)))
        ends_m = ends_m.mean(axis=0) + share * np.array([[-0.5], [0.5]]) * way
    return walk_to_and_fro(ends_m, speed_mps, config.timeline_length)


def _hinge(config: SceneConfig) -> FloatArray:
    return np.array([_MIDDLE_X_M - 0.45, FRONT_Y_M + config.near_m])


def _door_angle(count: int) -> FloatArray:
    """Return yaws (N,) of a door that swings between edge-on and across the view."""
    t = np.arange(count) / FRAME_RATE_HZ
    return np.asarray(np.pi / 4 * (1 + np.cos(2 * np.pi * t / _DOOR_PERIOD_S)))


def _door(config: SceneConfig, _camera: FloatArray, _rng: Rng) -> FloatArray:
    count = config.timeline_length
    xy = np.tile(_hinge(config), (count, 1))
    return upright_poses(xy, 0.0, _door_angle(count))


def _drive(config: SceneConfig, _camera: FloatArray, _rng: Rng) -> FloatArray:
    """Return poses of an object that drives past the camera, turns and comes back."""
    count, y = config.timeline_length, FRONT_Y_M + config.near_m
    ends = np.array([[0.6, y], [2 * _MIDDLE_X_M - 0.6, y]])
    xy, heading = _pass(config, ends)
    return upright_poses(xy[:count], 0.0, heading[:count])


def _roll(config: SceneConfig, _camera: FloatArray, _rng: Rng) -> FloatArray:
    count, y = config.timeline_length, FRONT_Y_M + config.near_m
    ends = np.array([[0.8, y], [2 * _MIDDLE_X_M - 0.8, y + 0.3]])
    xy, heading = _pass(config, ends)
    t = np.arange(count) / FRAME_RATE_HZ
    bounce = 0.16 + 0.5 * np.abs(np.sin(2 * np.pi * t / 1.6))
    return upright_poses(xy[:count], bounce, heading[:count])


def _stroll(config: SceneConfig, _camera: FloatArray, _rng: Rng) -> FloatArray:
    count, y = config.timeline_length, FRONT_Y_M + config.near_m + _FLOOR_SEEN_M
    ends = np.array([[_MIDDLE_X_M - 1.4, y], [_MIDDLE_X_M + 1.4, y]])
    xy, heading = _pass(config, ends)
    return upright_poses(xy[:count], 0.0, heading[:count])


def _lead(config: SceneConfig, T_world_camera: FloatArray, _rng: Rng) -> FloatArray:
    """Return poses of an object that keeps its distance ahead of the camera."""
    count = config.timeline_length
    kernel = np.hanning(31) / np.hanning(31).sum()
    padded = np.pad(T_world_camera[:count, :2, 3], ((15, 15), (0, 0)), 'edge')
    xy = np.stack([np.convolve(column, kernel, 'valid') for column in padded.T], -1)
    t = np.arange(count) / FRAME_RATE_HZ
    ahead = np.stack([0.15 * np.sin(2 * np.pi * t / 6), np.full(count, config.near_m)], -1)
    return upright_poses(xy + ahead, 0.0, 0.0)


def _fall(config: SceneConfig, _camera: FloatArray, rng: Rng) -> FloatArray:
    """Return poses of a picture that hangs on the far wall, falls, and stays on the floor."""
    count = config.timeline_length
    t = np.arange(count) / FRAME_RATE_HZ
    since_s = np.maximum(t - count / FRAME_RATE_HZ / 3, 0)
    z = np.maximum(1.25 - 0.5 * _GRAVITY_MPS2 * since_s**2, 0.0)
    x = _MIDDLE_X_M + float(rng.uniform(-0.3, 0.3))
    xy = np.tile([x, DEPTH_M - 0.6], (count, 1))
    return upright_poses(xy, z, 0.0)


def _slide(config: SceneConfig, _camera: FloatArray, _rng: Rng) -> FloatArray:
    """Return poses of a panel that hangs from the ceiling and slides across the view."""
    t = np.arange(config.timeline_length) / FRAME_RATE_HZ
    x = _MIDDLE_X_M + _SLIDE_M * np.sin(2 * np.pi * t / _SLIDE_PERIOD_S)
    xy = np.stack([x, np.full(len(x), FRONT_Y_M + config.near_m)], -1)
    return upright_poses(xy, 0.0, 0.0)
