"""An accelerometer makes the map frame level, also from a tilted start."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.slam_status import SlamState
from hoid_common.values import FloatArray
from rgbd_slam.inertial.report import report_of
from rgbd_slam.inertial.rotations import rotations
from rgbd_slam.leveling import Leveling
from rgbd_slam.robot_frames import RobotFrames, camera_mount
from rgbd_slam.tracking.tracking_result import TrackingResult

from .shaken_imu import START_NS, UP_WORLD, ShakenImu, pose

STAMP_NS = 10**9
AXES: FloatArray = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def tilted(pitch_deg: float, roll_deg: float = 0.0) -> FloatArray:
    """Return the direction up (3,) in the optical frame of a camera that looks down."""
    T_world_camera = camera_mount(roll_deg, pitch_deg, 0.0)
    return np.asarray(T_world_camera[:3, :3].T @ [0.0, 0.0, 1.0])


@pytest.mark.parametrize(('pitch_deg', 'roll_deg'), [(35.0, 0.0), (-20.0, 60.0), (0.0, 180.0)])
def test_the_map_frame_has_z_up(pitch_deg: float, roll_deg: float) -> None:
    frames = RobotFrames()
    frames.level(tilted(pitch_deg, roll_deg))
    up_map = frames.T_map_core[:3, :3] @ tilted(pitch_deg, roll_deg)
    np.testing.assert_allclose(up_map, [0, 0, 1], atol=1e-12)


def test_the_heading_stays_and_a_level_camera_changes_nothing() -> None:
    frames = RobotFrames()
    assert frames.level(tilted(0.0)) == pytest.approx(0.0)
    np.testing.assert_allclose(frames.T_map_core, T_BODY_OPTICAL, atol=1e-12)
    assert frames.level(tilted(30.0)) == pytest.approx(np.deg2rad(30.0))
    forward = frames.T_map_core[:3, 2]  # optical z in the map
    np.testing.assert_allclose(forward, [np.cos(np.pi / 6), 0, -0.5], atol=1e-12)


def test_odom_to_base_does_not_jump_while_map_to_odom_does() -> None:
    frames = RobotFrames()
    T = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    before = frames.robot_pose(STAMP_NS, T, T, np.zeros((6, 6)))
    frames.level(tilted(25.0))
    after = frames.robot_pose(STAMP_NS + 33_000_000, T, T, np.zeros((6, 6)))
    np.testing.assert_array_equal(after.T_odom_base, before.T_odom_base)
    np.testing.assert_allclose(before.T_map_odom, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(
        after.T_map_odom @ after.T_odom_base, frames.T_map_core @ T, atol=1e-12
    )


def test_a_pose_from_the_map_is_found_after_leveling() -> None:
    mount = camera_mount(0.0, 20.0, 0.0)
    frames = RobotFrames(mount)
    frames.level(np.asarray(mount[:3, :3].T @ tilted(0.0, 0.0)))
    T_map_base = se3.exp(np.array([0.0, 0.0, 0.5, 1.0, 2.0, 0.0]))
    T_core_camera = frames.camera_at(T_map_base)
    found = frames.robot_pose(STAMP_NS, T_core_camera, T_core_camera, np.zeros((6, 6)))
    np.testing.assert_allclose(found.T_map_odom @ found.T_odom_base, T_map_base, atol=1e-9)


def test_a_fixed_frame_and_a_planar_base_are_not_turned() -> None:
    fixed, planar = RobotFrames(), RobotFrames(T_BODY_OPTICAL, planar=True)
    fixed.is_fixed = True
    for frames in (fixed, planar):
        assert frames.level(tilted(30.0)) == 0.0
        np.testing.assert_array_equal(frames.T_map_core, T_BODY_OPTICAL)


def test_the_map_is_level_after_a_tilted_start_and_is_then_kept() -> None:
    shaken, frames = ShakenImu(accelerometer=True, gyro=False), RobotFrames()
    leveling = Leveling(frames, shaken.imu)
    T_start_world = se3.inverse(pose(0.0))
    num_turns = 0
    while not frames.is_fixed:
        shaken.run(shaken.time_s + 0.5)
        stamp_ns = shaken.imu.up.stamp_ns if shaken.imu.up else START_NS
        T_map_camera = T_start_world @ pose(1e-9 * (stamp_ns - START_NS))
        result = TrackingResult(stamp_ns, SlamState.TRACKING, T_map_camera, T_map_camera)
        num_turns += leveling.update(result, is_in_main_map=True)
        assert shaken.time_s < 40
    assert num_turns > 3
    up_map = frames.T_map_core[:3, :3] @ T_start_world[:3, :3] @ UP_WORLD
    assert np.rad2deg(np.arccos(up_map[2])) < 1.0
    assert frames.is_level
    frames.take_saved()  # the frame of a saved map, of which nothing is known
    assert not frames.is_level


def test_nothing_is_turned_while_lost_or_in_another_map() -> None:
    shaken, frames = ShakenImu(accelerometer=True, gyro=False), RobotFrames()
    shaken.run(4.0)
    assert shaken.imu.up is not None
    stamp_ns = shaken.imu.up.stamp_ns
    lost = TrackingResult(stamp_ns, SlamState.LOST)
    other = TrackingResult(stamp_ns, SlamState.TRACKING, np.eye(4), np.eye(4))
    assert not Leveling(frames, shaken.imu).update(lost, is_in_main_map=True)
    assert not Leveling(frames, shaken.imu).update(other, is_in_main_map=False)
    assert not Leveling(frames, None).update(other, is_in_main_map=True)
    assert Leveling(frames, shaken.imu).update(other, is_in_main_map=True)


def leveled(shaken: ShakenImu, duration_s: float) -> tuple[RobotFrames, list[float]]:
    """Return the frames after a while, and the tilt [deg] of the map every half second."""
    frames = RobotFrames()
    leveling, T_start_world, tilts_deg = Leveling(frames, shaken.imu), se3.inverse(pose(0.0)), []
    while shaken.time_s < duration_s:
        shaken.run(shaken.time_s + 0.5)
        stamp_ns = shaken.imu.up.stamp_ns if shaken.imu.up else START_NS
        T_map_camera = T_start_world @ pose(1e-9 * (stamp_ns - START_NS))
        result = TrackingResult(stamp_ns, SlamState.TRACKING, T_map_camera, T_map_camera)
        leveling.update(result, is_in_main_map=True)
        up_map = frames.T_map_core[:3, :3] @ T_start_world[:3, :3] @ UP_WORLD
        tilts_deg.append(float(np.rad2deg(np.arccos(up_map[2]))))
    return frames, tilts_deg


@pytest.mark.slow
@pytest.mark.parametrize('offset_s', [-1.0, -0.4, 0.4, 0.5, 1.0])
@pytest.mark.parametrize('gyro', [True, False], ids=['both', 'accelerometer'])
def test_an_imu_with_a_wrong_clock_levels_nothing(offset_s: float, gyro: bool) -> None:
    """Neither its mounting nor its offset is told; its clock is wrong for both sensors."""
    shaken = ShakenImu(AXES, offset_s, accelerometer=True, gyro=gyro)
    frames, tilts_deg = leveled(shaken, 16.0)
    at_start_deg = leveled(ShakenImu(gyro=False), 0.5)[1][0]
    assert max(tilts_deg) < at_start_deg + 1.0
    assert not frames.is_fixed
    assert not frames.is_level
    assert report_of(shaken.imu).in_use == 'none'
    problem = shaken.imu.trust.problem
    assert ('the accelerometer, because it has the same clock' in problem) == gyro


@pytest.mark.slow
def test_an_accelerometer_that_is_turned_against_the_gyro_tilts_nothing_for_long() -> None:
    turned = rotations(np.deg2rad([12.0, 0.0, 16.0]))  # by 20 degrees
    shaken = ShakenImu(accelerometer=True, distort_force=lambda forces: forces @ turned.T)
    frames, tilts_deg = leveled(shaken, 16.0)
    assert tilts_deg[-1] == pytest.approx(leveled(ShakenImu(gyro=False), 0.5)[1][0])
    assert not frames.is_fixed
    assert 'does not agree with the tracked motion' in shaken.imu.trust.problem
