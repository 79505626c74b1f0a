"""Relocalization at a pose that RViz, for example, publishes on /initialpose."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from hoid_msgs.msg import SlamStatus
from rcl_interfaces.msg import Log

from hoid_common import se3
from hoid_common.ros import conversions
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.running_camera import RunningCamera, camera_at

AWAY = se3.exp(np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.0]))  # along x, forward, turned left


class Peer(RunningCamera):
    """Maps 40 places, and publishes initial poses near them."""

    def __init__(self, probe: Probe) -> None:
        self.log = probe.collect(Log, '/rosout', wait=False)
        super().__init__(probe)
        self.poses = probe.publisher(PoseWithCovarianceStamped, 'initialpose')
        self.begin()
        self.send_all(range(40))
        assert self.set_mode('localization').success

    def publish_pose(self, msg: PoseWithCovarianceStamped) -> None:
        self.poses.publish(msg)
        self.probe.spin_for(0.3)

    @property
    def answers(self) -> list[str]:
        """Return the lines that were logged about a given pose."""
        return [line.msg for line in self.log if 'pose given' in line.msg]

    def refused(self, msg: PoseWithCovarianceStamped) -> str:
        """Publish a pose that is refused, and return the line that is logged."""
        self.log.clear()
        self.publish_pose(msg)
        self.probe.spin_until(
            lambda: any(line.level >= 40 for line in self.log), 'nothing is logged'
        )
        return str(next(line.msg for line in self.log if line.level >= 40))


def pose(place: int, frame: str = 'map', off: FloatArray = AWAY) -> PoseWithCovarianceStamped:
    """Return a pose of the camera's body (x forward, z up), displaced from a place by `off`."""
    T = T_BODY_OPTICAL @ camera_at(place) @ se3.inverse(T_BODY_OPTICAL) @ off
    msg = PoseWithCovarianceStamped(header=conversions.header_to_msg(0, frame))
    msg.pose.pose = conversions.pose_to_msg(T)
    msg.pose.covariance[[0, 7, 35]] = 0.25, 0.25, 0.0685  # the values of RViz
    return msg


def test_the_camera_is_relocalized_near_the_initial_pose_first(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = Peer(probe)
    for frame in ('odom', 'map'):  # both frames are equal until the camera is relocalized
        peer.log.clear()
        peer.publish_pose(pose(20, frame))
        status = peer.send(20)
        assert status.state == SlamStatus.TRACKING
        assert status.message == 'found 0.3 m and 6 degrees from the pose given'
        np.testing.assert_allclose(peer.last_pose(), T_BODY_OPTICAL @ camera_at(20), atol=0.005)
        probe.spin_until(lambda: bool(peer.answers), 'nothing is logged')
        assert peer.answers == [status.message]

    behind = se3.exp(np.array([0.0, 0.0, math.pi, 0.0, 0.0, 0.0]))
    peer.publish_pose(pose(20, off=behind))
    lines = ['not found at the pose given; looking everywhere']
    lines += ['found 0.0 m and 180 degrees from the pose given']
    peer.log.clear()
    assert peer.send(20).message == lines[1]  # with the next image
    probe.spin_until(lambda: len(peer.answers) == 2, 'nothing is logged')
    assert peer.answers == lines


def test_an_invalid_initial_pose_is_refused_in_one_line(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = Peer(probe)
    assert peer.refused(pose(20, 'kitchen')) == (
        'no transform connects frame "kitchen" of initialpose with the map; give the pose in '
        'the map frame'
    )
    nan, zero, negative = pose(20), pose(20), pose(20)
    nan.pose.pose.position.x = math.nan
    zero.pose.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
    negative.pose.covariance[0] = -1.0
    line = peer.refused(nan)
    assert 'pose is no rigid transform' in line
    assert line.endswith(', on initialpose')
    peer.wait_for_count('initial poses refused', 2)
    peer.publish_pose(zero)  # a second line of this kind is throttled
    peer.wait_for_count('initial poses refused', 3)
    peer.publish_pose(negative)
    peer.wait_for_count('initial poses refused', 4)
    assert peer.send(39).state == SlamStatus.TRACKING
    assert peer.set_mode('mapping').success
    peer.publish_pose(pose(20))
    peer.wait_for_count('initial poses refused', 5)
    assert peer.send(39).message == ''
