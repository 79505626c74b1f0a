"""Somebody says on /initialpose where the robot is, as RViz does."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from hoid_msgs.msg import SlamStatus
from rcl_interfaces.msg import Log

from hoid_common import se3
from hoid_common.ros import conversions
from hoid_common.values import FloatArray
from hoid_system_tests.point_world import PointWorld, walked
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import NO_SCENE, PERIOD_NS, START_NS, SlamPeer, features_msg
from rgbd_slam.robot_frames import T_BODY_OPTICAL

AWAY = se3.exp(np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.0]))  # along x, forward, turned left


class Peer(SlamPeer):
    """Maps 40 places, and gives poses of them."""

    def __init__(self, probe: Probe) -> None:
        self.log = probe.collect(Log, '/rosout', wait=False)
        super().__init__(probe)
        self.world, self.num_sent = PointWorld(3000), 0
        self.poses = probe.publisher(PoseWithCovarianceStamped, 'initialpose')
        self.begin()
        for place in range(40):
            self.send(place)
        assert self.set_mode('localization').success

    def send(self, place: int) -> SlamStatus:
        stamp_ns = START_NS + self.num_sent * PERIOD_NS
        self.num_sent += 1
        return self.answer_to(features_msg(self.world.features(walked(place, 0.01), stamp_ns)))

    def give(self, msg: PoseWithCovarianceStamped) -> None:
        self.poses.publish(msg)
        self.probe.spin_for(0.3)

    def refused(self, msg: PoseWithCovarianceStamped) -> str:
        """Give a pose that is refused; return the new line of the log."""
        self.log.clear()
        self.give(msg)
        self.probe.spin_until(
            lambda: any(line.level >= 40 for line in self.log), 'nothing is logged'
        )
        return str(next(line.msg for line in self.log if line.level >= 40))


def pose(place: int, frame: str = 'map', off: FloatArray = AWAY) -> PoseWithCovarianceStamped:
    """Return a pose off that of a place, of the camera's body: x forward, z up."""
    T = T_BODY_OPTICAL @ walked(place, 0.01) @ se3.inverse(T_BODY_OPTICAL) @ off
    msg = PoseWithCovarianceStamped(header=conversions.header_to_msg(0, frame))
    msg.pose.pose = conversions.pose_to_msg(T)
    msg.pose.covariance[[0, 7, 35]] = 0.25, 0.25, 0.0685  # what RViz sends
    return msg


def test_the_camera_is_looked_for_there_first(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', NO_SCENE)
    peer = Peer(probe)
    for frame in ('odom', 'map'):  # the same, until the camera is found elsewhere
        peer.log.clear()
        peer.give(pose(20, frame))
        status = peer.send(20)
        assert status.state == SlamStatus.TRACKING
        assert status.message == 'found 0.3 m and 6 degrees from the pose given'
        T = peer.pose(START_NS + (peer.num_sent - 1) * PERIOD_NS)
        np.testing.assert_allclose(T, T_BODY_OPTICAL @ walked(20, 0.01), atol=0.005)
        probe.spin_until(lambda: bool(peer.log), 'nothing is logged')
        assert [line.msg for line in peer.log] == [status.message]

    behind = se3.exp(np.array([0.0, 0.0, math.pi, 0.0, 0.0, 0.0]))
    peer.give(pose(20, off=behind))
    lines = ['not found at the pose given; looking everywhere']
    lines += ['found 0.0 m and 180 degrees from the pose given']
    peer.log.clear()
    assert peer.send(20).message == lines[1]  # at once
    probe.spin_until(lambda: len(peer.log) == 2, 'nothing is logged')
    assert [line.msg for line in peer.log] == lines


def test_what_is_no_pose_is_refused_in_a_line(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', NO_SCENE)
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
    assert peer.diagnosis()[1]['initial poses refused'] == '2'
    peer.give(zero)  # a second line of the kind is held back
    assert peer.diagnosis()[1]['initial poses refused'] == '3'
    peer.give(negative)
    assert peer.diagnosis()[1]['initial poses refused'] == '4'
    assert peer.send(39).state == SlamStatus.TRACKING
    assert peer.set_mode('mapping').success
    peer.give(pose(20))
    assert peer.diagnosis()[1]['initial poses refused'] == '5'
    assert peer.send(39).message == ''
