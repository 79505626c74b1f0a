"""Poses of a robot with a tilted camera that drives forward and turns agree with known poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common import se3
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from rgbd_slam.robot_frames import RobotFrames, camera_mount

S = 10**9
TILT = se3.exp(np.array([0.0, np.deg2rad(20), 0, 0, 0, 0]))  # nose down
T_BASE_CAMERA = TILT @ T_BODY_OPTICAL
T_BASE_CAMERA[:3, 3] = 0.1, 0.0, 0.5
twists = st.lists(st.floats(-2, 2), min_size=6, max_size=6).map(np.array)


def move(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    T = se3.exp(np.array([0, 0, yaw, 0, 0, 0.0]))
    T[:2, 3] = x, y
    return T


def camera_at(T_start_base: FloatArray) -> FloatArray:
    """Return the camera's pose in the first camera's frame for a base moved from its start."""
    return se3.inverse(T_BASE_CAMERA) @ T_start_base @ T_BASE_CAMERA


def test_the_map_starts_at_the_base_and_is_level() -> None:
    frames = RobotFrames(T_BASE_CAMERA)
    pose = frames.robot_pose(S, np.eye(4), np.eye(4), np.eye(6))
    np.testing.assert_allclose(pose.T_odom_base, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(pose.T_map_odom, np.eye(4), atol=1e-12)
    assert not pose.twist.any()


def test_the_mount_of_a_camera_is_given_by_roll_pitch_and_yaw() -> None:
    np.testing.assert_allclose(camera_mount(0, 20, 0), TILT @ T_BODY_OPTICAL, atol=1e-12)
    down = camera_mount(0, 45, 0)[:3, 2]  # the viewing direction
    np.testing.assert_allclose(down, [np.sqrt(0.5), 0, -np.sqrt(0.5)], atol=1e-12)
    right = camera_mount(90, 0, 0)[:3, 0]  # the image's x axis points to the floor
    np.testing.assert_allclose(right, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(camera_mount(0, 0, 90)[:3, 2], [0, 1, 0], atol=1e-12)


def test_driving_forward_and_turning() -> None:
    frames = RobotFrames(T_BASE_CAMERA)
    frames.robot_pose(S, np.eye(4), np.eye(4), np.eye(6))
    driven = camera_at(move(x=0.1, yaw=0.2))
    pose = frames.robot_pose(S + S // 10, driven, driven, np.eye(6))
    np.testing.assert_allclose(pose.T_odom_base, move(x=0.1, yaw=0.2), atol=1e-12)
    np.testing.assert_allclose(pose.twist[:3], [0, 0, 2.0], atol=1e-9)
    assert pose.twist[3] == pytest.approx(1.0, rel=0.01)


def test_a_corrected_map_moves_odom_and_not_the_base() -> None:
    frames = RobotFrames(T_BASE_CAMERA)
    drift = move(y=0.3)
    pose = frames.robot_pose(S, camera_at(drift @ move(x=1)), camera_at(move(x=1)), np.eye(6))
    np.testing.assert_allclose(pose.T_odom_base, move(x=1), atol=1e-12)
    np.testing.assert_allclose(pose.T_map_odom, drift, atol=1e-12)


def test_without_a_base_the_optical_frame_is_placed_in_a_z_up_map() -> None:
    frames = RobotFrames()
    ahead = np.eye(4)
    ahead[:3, 3] = 0, -1, 2  # optical: one up, two forward
    pose = frames.robot_pose(S, ahead, ahead, np.eye(6))
    np.testing.assert_allclose(pose.T_odom_base[:3, 3], [2, 0, 1])
    np.testing.assert_allclose(pose.T_odom_base[:3, :3], T_BODY_OPTICAL[:3, :3])


def test_a_planar_base_neither_rises_nor_tilts() -> None:
    frames = RobotFrames(T_BASE_CAMERA, planar=True)
    bumpy = move(x=1, y=2, yaw=0.7) @ se3.exp(np.array([0.02, -0.03, 0, 0, 0, 0.05]))
    pose = frames.robot_pose(S, camera_at(bumpy), camera_at(bumpy), np.eye(6))
    np.testing.assert_allclose(pose.T_odom_base[2, :], [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(pose.T_odom_base[:2, 3], bumpy[:2, 3], atol=1e-12)
    np.testing.assert_allclose(pose.T_map_odom, np.eye(4), atol=1e-12)


@given(twists, twists)
def test_adjoint_moves_a_small_motion_to_another_frame(a: FloatArray, b: FloatArray) -> None:
    """T exp(x) = exp(Ad x) T."""
    T, x = se3.exp(a), 0.1 * b
    np.testing.assert_allclose(T @ se3.exp(x), se3.exp(se3.adjoint(T) @ x) @ T, atol=1e-9)


def test_a_lever_arm_turns_rotation_noise_into_translation_noise() -> None:
    frames = RobotFrames(T_BASE_CAMERA)
    rotation_only = np.diag([1e-4, 1e-4, 1e-4, 0, 0, 0])
    pose = frames.robot_pose(S, np.eye(4), np.eye(4), rotation_only)
    lever = T_BASE_CAMERA[:3, 3]
    expected = 1e-4 * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    np.testing.assert_allclose(pose.covariance[3:, 3:], expected, atol=1e-12)


def test_the_covariance_of_a_velocity_is_that_of_both_poses_over_the_time_between() -> None:
    frames = RobotFrames()
    own = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])
    frames.robot_pose(S, np.eye(4), np.eye(4), np.eye(6), own)
    pose = frames.robot_pose(S + S // 10, np.eye(4), np.eye(4), np.eye(6), own)
    np.testing.assert_allclose(pose.twist_covariance, 2 * own / 0.1**2)
    np.testing.assert_allclose(pose.covariance, np.eye(6))


def test_no_velocity_over_a_gap_or_back_in_time() -> None:
    frames = RobotFrames()
    frames.robot_pose(10 * S, np.eye(4), np.eye(4), np.eye(6))
    far = np.eye(4)
    far[0, 3] = 1
    late = frames.robot_pose(12 * S, far, far, np.eye(6))
    assert not late.twist.any()
    assert np.sqrt(np.diag(late.twist_covariance)).min() > 3  # nothing is known of it
    assert not frames.robot_pose(11 * S, np.eye(4), np.eye(4), np.eye(6)).twist.any()
