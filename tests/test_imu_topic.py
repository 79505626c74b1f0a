"""The SLAM node with an IMU on its topics: turns, a covered lens, a level map, and faults."""

from __future__ import annotations

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu
from tf2_msgs.msg import TFMessage

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.messages import imu_from_msg
from hoid_common.ros import conversions, qos
from hoid_common.values import S_PER_NS, FloatArray
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import PointWorld
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg
from rgbd_slam.robot_frames import camera_mount

IMU_FRAME = 'imu_frame'
IMU_NS = 5_000_000
# The IMU has x forward, y left, z up; the camera looks down by 25 degrees at the start.
R_CAMERA_IMU: FloatArray = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
T_WORLD_START = camera_mount(0.0, 25.0, 0.0)
BIAS: FloatArray = np.array([0.01, -0.015, 0.02])


def pose(stamp_ns: float) -> FloatArray:
    """Return T_start_camera (4, 4): a hand that shakes the camera."""
    time_s = S_PER_NS * (stamp_ns - START_NS)
    turn = np.array([0.1, 0.15, 0.08]) * np.sin(2 * np.pi * np.array([0.5, 0.7, 0.9]) * time_s)
    move = np.array([0.06, 0.05, 0.05]) * np.sin(2 * np.pi * np.array([0.7, 0.6, 0.8]) * time_s)
    T = se3.exp(np.append(turn, np.zeros(3)))
    T[:3, 3] = move
    return T


def imu_msg(stamp_ns: int) -> Imu:
    """Return what the IMU measures at a time."""
    half_s = 0.005
    first, now, last = (pose(stamp_ns + k * 5_000_000) for k in (-1, 0, 1))
    rate = R_CAMERA_IMU.T @ se3.log(se3.inverse(first) @ last)[:3] / (2 * half_s) + BIAS
    acceleration = (first - 2 * now + last)[:3, 3] / half_s**2
    up = T_WORLD_START[2, :3]
    force = R_CAMERA_IMU.T @ now[:3, :3].T @ (acceleration + 9.81 * up)
    msg = Imu(header=conversions.header_to_msg(stamp_ns, IMU_FRAME))
    msg.orientation_covariance[0] = -1.0
    msg.angular_velocity.x, msg.angular_velocity.y, msg.angular_velocity.z = rate.tolist()
    force_xyz = msg.linear_acceleration
    force_xyz.x, force_xyz.y, force_xyz.z = force.tolist()
    return msg


class Peer(SlamPeer):
    """Publishes the features of a shaken camera and the samples of an IMU beside it."""

    def __init__(self, probe: Probe, scale: float = 1.0) -> None:
        super().__init__(probe)
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        self.imu = probe.publisher(Imu, 'imu', qos_profile_sensor_data)
        self._world, self._scale = PointWorld(4000), scale
        self._sampled_ns = START_NS - 500_000_000
        self.image = 0

    def publish_mounting(self) -> None:
        """Publish how the IMU is mounted."""
        static = self.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
        T = np.eye(4)
        T[:3, :3] = R_CAMERA_IMU
        edge = conversions.transform_to_msg(T, START_NS, OPTICAL, IMU_FRAME)
        static.publish(TFMessage(transforms=[edge]))
        self.probe.spin_for(0.3)

    def wait_for_odometry(self) -> int:
        """Wait until each image has a pose, and return their number."""
        self.probe.spin_until(lambda: len(self.odom) == self.image, 'odometry is missing')
        return self.image

    def step(self, *, is_covered: bool = False) -> SlamStatus:
        """Publish the samples up to the next image and the image; return its status."""
        stamp_ns = START_NS + self.image * PERIOD_NS
        while self._sampled_ns < stamp_ns + 20_000_000:
            self._sampled_ns += IMU_NS
            msg = imu_msg(self._sampled_ns)
            rate = msg.angular_velocity
            rate.x, rate.y, rate.z = (self._scale * value for value in (rate.x, rate.y, rate.z))
            self.imu.publish(msg)
        self.probe.spin_for(0.01)
        seen = self._world.features(pose(stamp_ns), stamp_ns)
        self.image += 1
        return self.answer_to(features_msg(seen.select(np.arange(0)) if is_covered else seen))


@pytest.mark.thorough
def test_a_covered_lens_is_bridged_and_the_map_is_level(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = Peer(probe)
    peer.publish_mounting()
    peer.begin()
    for _ in range(150):
        status = peer.step()
    assert status.state == SlamStatus.TRACKING
    T_map_camera = peer.pose(START_NS + 149 * PERIOD_NS)
    up_map = (
        T_map_camera[:3, :3] @ pose(START_NS + 149 * PERIOD_NS)[:3, :3].T @ T_WORLD_START[2, :3]
    )
    assert np.rad2deg(np.arccos(up_map[2])) < 1.0  # without the IMU it is 25 degrees
    num_poses = peer.wait_for_odometry()
    for _ in range(15):
        status = peer.step(is_covered=True)
    assert status.state == SlamStatus.LOST
    assert 'the pose follows the gyro, for 0.5 s' in status.message
    assert peer.wait_for_odometry() == num_poses + 15
    first, last = (
        conversions.pose_from_msg(peer.odom[k].pose.pose) for k in (num_poses - 1, num_poses + 14)
    )
    true = se3.inverse(pose(START_NS + 149 * PERIOD_NS)) @ pose(START_NS + 164 * PERIOD_NS)
    error = se3.log(se3.inverse(true) @ se3.inverse(first) @ last)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 1.0
    assert np.linalg.norm(error[3:]) < 0.1
    assert peer.step().state == SlamStatus.TRACKING
    _, values = peer.diagnosis()
    assert int(values['IMU samples']) > 900
    assert values['IMU sensors in use'] == 'gyro, accelerometer'
    assert abs(int(values['IMU time offset'].removesuffix(' ms'))) <= 3


def test_a_gyro_in_degrees_is_reported_and_left_out(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'imu.level': False})
    peer = Peer(probe, scale=float(np.rad2deg(1.0)))
    peer.begin()
    impossible = imu_msg(START_NS - 400_000_000)
    impossible.angular_velocity.x = 1e300
    peer.imu.publish(impossible)
    for _ in range(75):
        assert peer.step().state == SlamStatus.TRACKING
    message, values = peer.diagnosis()
    assert values['IMU samples left out'] == '1'
    assert 'imu: the gyro is left out: its rates are in degrees per second' in message


def test_sensors_that_a_message_lacks_are_none() -> None:
    msg = imu_msg(START_NS)
    assert imu_from_msg(msg).stamp_ns == START_NS
    assert imu_from_msg(msg).rate_radps is not None
    msg.angular_velocity_covariance[0] = -1.0
    assert imu_from_msg(msg).rate_radps is None
    assert imu_from_msg(msg).acceleration_mps2 is not None
    force = msg.linear_acceleration
    force.x = force.y = force.z = 0.0
    with pytest.raises(MessageError, match='neither angular velocity nor acceleration'):
        imu_from_msg(msg)
