"""The frame tree of a robot on real topics: planar motion, and edges that somebody else sends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from hoid_bringup.supervisor import Supervisor
from hoid_common import se3
from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from hoid_system_tests.point_world import CAMERA, PointWorld
from hoid_system_tests.probe import Probe
from rgbd_slam.frames import T_BODY_OPTICAL, flattened

START_NS, PERIOD_NS = 1_305_031_102_175_304_123, 33_333_333
OPTICAL = 'camera_color_optical_frame'
NO_ROOM = {'dense.enabled': False, 'objects.enabled': False}
IMAGES = 12
T_BASE_CAMERA = se3.exp(np.array([0, 0, 0, 0.2, 0.0, 1.0])) @ T_BODY_OPTICAL

Start = Callable[..., Supervisor]


def camera_at(i: int) -> FloatArray:
    """Return T_world_camera of image i: forward, up, turning left and nodding."""
    T = se3.exp(np.array([0.004 * i, -0.01 * i, 0.003 * i, 0, 0, 0]))
    T[:3, 3] = 0.0, -0.01 * i, 0.015 * i
    return T


class Peer:
    """Sends a dozen images and keeps what is said of them."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        self.status = probe.collect(SlamStatus, 'slam_status', wait=False)
        self.tf = probe.collect(TFMessage, '/tf', qos.TF, wait=False)
        self.diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)

    def say_where_the_camera_sits(self) -> None:
        static = self.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
        T = conversions.transform_to_msg(T_BASE_CAMERA, START_NS, 'base_link', OPTICAL)
        static.publish(TFMessage(transforms=[T]))
        self.probe.spin_for(0.3)

    def play(self) -> None:
        world = PointWorld()
        camera = self.probe.publisher(CameraInfo, 'rgb/camera_info')
        features = self.probe.publisher(FeaturesMsg, 'features')
        header = conversions.header_to_msg(START_NS, OPTICAL)
        camera.publish(conversions.camera_to_msg(CAMERA, header))
        self.probe.spin_until(lambda: bool(self.status), 'the node does not get ready', 60.0)
        for i in range(IMAGES):
            stamp_ns, before = START_NS + i * PERIOD_NS, len(self.status)
            header = conversions.header_to_msg(stamp_ns, OPTICAL)
            seen = world.features(camera_at(i), stamp_ns)
            size_px = (CAMERA.width_px, CAMERA.height_px)
            features.publish(conversions.features_to_msg(seen, header, size_px))
            self.probe.spin_until(lambda n=before: len(self.status) > n, 'no status')  # type: ignore[misc]
        self.probe.spin_until(lambda: len(self.odom) == IMAGES, 'odometry is missing')
        self.probe.spin_for(0.3)

    def edges(self) -> set[tuple[str, str]]:
        every = [edge for msg in self.tf for edge in msg.transforms]
        return {(edge.header.frame_id, edge.child_frame_id) for edge in every}


def expected_bases() -> list[FloatArray]:
    T = T_BASE_CAMERA
    return [T @ camera_at(i) @ se3.inverse(T) for i in range(IMAGES)]


def poses(odom: list[Any]) -> FloatArray:
    return np.array([conversions.pose_from_msg(msg.pose.pose) for msg in odom])


def test_a_planar_robot_stays_on_the_floor_and_upright(start: Start, probe: Probe) -> None:
    parameters = {'frames.base': 'base_link', 'frames.planar': True}
    start('rgbd_slam', 'rgbd_slam_node', parameters | NO_ROOM)
    peer = Peer(probe)
    peer.say_where_the_camera_sits()
    peer.play()
    moved = poses(peer.odom)
    np.testing.assert_allclose(moved[:, 2, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved[:, 2, :3], np.tile([0.0, 0, 1], (IMAGES, 1)), atol=1e-9)
    true = np.array([flattened(T) for T in expected_bases()])
    np.testing.assert_allclose(moved, true, atol=0.005)
    assert np.linalg.norm(expected_bases()[-1][2, 3]) > 0.05  # which it has to leave out
    assert peer.edges() == {('map', 'odom'), ('odom', 'base_link')}
    for msg in peer.tf:
        for edge in msg.transforms:
            assert conversions.transform_from_msg(edge)[2, 3] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ('switch', 'left'),
    [
        ('frames.publish_map_to_odom', {('odom', OPTICAL)}),
        ('frames.publish_odom_to_base', {('map', 'odom')}),
    ],
)
def test_an_edge_is_left_to_somebody_else(
    start: Start, probe: Probe, switch: str, left: set[tuple[str, str]]
) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {switch: False} | NO_ROOM)
    peer = Peer(probe)
    peer.play()
    assert peer.edges() == left
    np.testing.assert_allclose(
        poses(peer.odom)[-1], T_BODY_OPTICAL @ camera_at(IMAGES - 1), atol=0.005
    )


def test_planar_motion_without_a_base_is_said_to_have_no_effect(
    start: Start, probe: Probe
) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'frames.planar': True} | NO_ROOM)
    peer = Peer(probe)
    peer.play()
    peer.probe.spin_until(
        lambda: any('frames.planar needs frames.base' in s.message for s in said(peer)),
        'nothing is said',
    )


def said(peer: Peer) -> list[Any]:
    return [status for msg in peer.diagnostics for status in msg.status]
