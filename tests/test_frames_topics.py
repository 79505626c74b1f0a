"""The frame tree of a robot: planar motion, and transforms that other nodes publish."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

from hoid_common import se3
from hoid_common.poses.frames import PoseBuffer
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import NS_PER_S, Features, FloatArray
from hoid_system_tests.frame_tree import OPTICAL, edges
from hoid_system_tests.point_world import CAMERA, PointWorld
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import (
    PERIOD_NS,
    START_NS,
    SlamPeer,
    features_msg,
)
from rgbd_slam.robot_frames import flattened

IMAGES = 12
T_BASE_CAMERA = se3.exp(np.array([0, 0, 0, 0.2, 0.0, 1.0])) @ T_BODY_OPTICAL


def camera_at(i: int) -> FloatArray:
    """Return the (4, 4) T_world_camera of image i: forward, up, turning left and nodding."""
    T = se3.exp(np.array([0.004 * i, -0.01 * i, 0.003 * i, 0, 0, 0]))
    T[:3, 3] = 0.0, -0.01 * i, 0.015 * i
    return T


class Peer(SlamPeer):
    """Publishes the features of a dozen images of a point world."""

    def __init__(self, probe: Probe) -> None:
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        super().__init__(probe)

    def publish_camera_mounting(self) -> None:
        static = self.probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
        T = conversions.transform_to_msg(T_BASE_CAMERA, START_NS, 'base_link', OPTICAL)
        static.publish(TFMessage(transforms=[T]))
        self.probe.spin_for(0.3)

    def play(self) -> None:
        world = PointWorld()
        self.begin()
        for i in range(IMAGES):
            seen = world.features(camera_at(i), START_NS + i * PERIOD_NS)
            self.answer_to(features_msg(seen))
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
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer = Peer(probe)
    peer.publish_camera_mounting()
    peer.play()
    for msg in peer.odom:  # zeros would mean that the covariance is unknown
        assert (np.linalg.eigvalsh(np.reshape(msg.pose.covariance, (6, 6))) > 0).all()
    moved = poses(peer.odom)
    np.testing.assert_allclose(moved[:, 2, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved[:, 2, :3], np.tile([0.0, 0, 1], (IMAGES, 1)), atol=1e-9)
    true = np.array([flattened(T) for T in expected_bases()])
    np.testing.assert_allclose(moved, true, atol=0.005)
    # Without `frames.planar` the height would change.
    assert np.linalg.norm(expected_bases()[-1][2, 3]) > 0.05
    assert peer.edges() == {('map', 'odom'), ('odom', 'base_link')}
    for msg in peer.tf:
        for edge in msg.transforms:
            assert conversions.transform_from_msg(edge)[2, 3] == pytest.approx(0, abs=1e-9)


def test_map_to_odom_is_not_published_when_switched_off(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'frames.publish_map_to_odom': False})
    peer = Peer(probe)
    peer.play()
    assert peer.edges() == {('odom', OPTICAL)}
    np.testing.assert_allclose(
        poses(peer.odom)[-1], T_BODY_OPTICAL @ camera_at(IMAGES - 1), atol=0.005
    )


class Wheels:
    """Wheel odometry on /tf at 50 Hz, which slips and starts 5 m away."""

    def __init__(self, probe: Probe) -> None:
        self._tf = probe.publisher(TFMessage, '/tf', qos.TF)

    @staticmethod
    def at(stamp_ns: int) -> FloatArray:
        """Return the (4, 4) T_odom_base of wheels that report 2 m/s and 0.3 rad/s."""
        driven_s = (stamp_ns - START_NS) / NS_PER_S
        start = se3.exp(np.array([0, 0, 0.5, 5.0, 1.0, 0.0]))
        return start @ se3.exp(np.array([0.0, 0.0, 0.3, 2.0, 0.0, 0.0]) * driven_s)

    def send_around(self, stamp_ns: int) -> None:
        """Publish the transforms 7 ms before and 13 ms after an image."""
        for at_ns in (stamp_ns - 7_000_000, stamp_ns + 13_000_000):
            T = conversions.transform_to_msg(self.at(at_ns), at_ns, 'odom', 'base_link')
            self._tf.publish(TFMessage(transforms=[T]))


def test_slipping_wheels_do_not_move_the_pose_and_bridge_a_covered_lens(
    start: Start, probe: Probe
) -> None:
    parameters = {'frames.base': 'base_link', 'frames.publish_odom_to_base': False}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    own = probe.collect(Odometry, 'visual_odom', wait=False)
    peer, wheels, world = Peer(probe), Wheels(probe), PointWorld()
    peer.publish_camera_mounting()
    peer.begin()

    def send(features: Features) -> None:
        wheels.send_around(features.stamp_ns)
        probe.spin_for(0.05)
        peer.answer_to(features_msg(features))

    def map_to_odom(i: int) -> FloatArray:
        """Return the (4, 4) T_map_odom for an image, which is stamped 0.1 s ahead."""
        dated_ns = START_NS + i * PERIOD_NS + NS_PER_S // 10
        probe.spin_until(lambda: ('map', 'odom') in edges(peer.tf, dated_ns), 'no map -> odom')
        return edges(peer.tf, dated_ns)['map', 'odom']

    for i in range(IMAGES):
        send(world.features(camera_at(i), START_NS + i * PERIOD_NS))
    bases = [map_to_odom(i) @ wheels.at(START_NS + i * PERIOD_NS) for i in range(IMAGES)]
    np.testing.assert_allclose(bases, expected_bases(), atol=0.005)
    np.testing.assert_allclose(poses(own), expected_bases(), atol=0.005)
    # Its poses are metres away from those of the wheels, whose frame is `odom`.
    assert {msg.header.frame_id for msg in own} == {'visual_odom'}
    assert peer.odom == []
    for i in range(IMAGES, IMAGES + 3):  # the lens is covered
        seen = world.features(camera_at(i), START_NS + i * PERIOD_NS)
        send(seen.select(np.arange(0)))
        np.testing.assert_allclose(map_to_odom(i), map_to_odom(IMAGES - 1), atol=1e-9)
    bridged = poses(own[IMAGES:])  # by the wheels alone
    steps = se3.inverse(wheels.at(START_NS + (IMAGES - 1) * PERIOD_NS)) @ [
        wheels.at(START_NS + i * PERIOD_NS) for i in range(IMAGES, IMAGES + 3)
    ]
    np.testing.assert_allclose(bridged, poses(own)[IMAGES - 1] @ steps, atol=1e-6)
    sigma_m = [math.sqrt(msg.pose.covariance[0]) for msg in own[IMAGES - 1 :]]
    assert (np.diff(sigma_m) > 0.01).all()  # it grows by the slip measured before
    status = peer.status[-1]
    assert status.state == SlamStatus.LOST
    assert status.message == (
        'too few map points are seen; the pose follows the wheel odometry, for 0.1 s and 0.20 m'
    )
    seen = world.features(camera_at(IMAGES), START_NS + (IMAGES + 3) * PERIOD_NS)
    send(seen)
    assert (peer.status[-1].state, peer.status[-1].relocalizations) == (SlamStatus.TRACKING, 0)
    base = map_to_odom(IMAGES + 3) @ wheels.at(START_NS + (IMAGES + 3) * PERIOD_NS)
    T = T_BASE_CAMERA @ camera_at(IMAGES) @ se3.inverse(T_BASE_CAMERA)
    np.testing.assert_allclose(base, T, atol=0.005)


class SlippingWheels(Wheels):
    """Wheel odometry of a robot that stands still, and whose wheels slip by 0.5 m at once."""

    @staticmethod
    def at(stamp_ns: int) -> FloatArray:
        has_slipped = stamp_ns >= START_NS + (IMAGES // 2) * PERIOD_NS - 7_000_000
        return se3.exp(np.array([0, 0, 0, 0.5 if has_slipped else 0.0, 0, 0]))


def test_an_instant_slip_shows_for_the_transform_tolerance_and_no_longer(
    start: Start, probe: Probe
) -> None:
    parameters = {
        'frames.base': 'base_link',
        'frames.publish_odom_to_base': False,
        'frames.transform_tolerance_s': 0.05,
    }
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer, wheels, world = Peer(probe), SlippingWheels(probe), PointWorld()
    peer.publish_camera_mounting()
    peer.begin()
    for i in range(IMAGES):
        seen = world.features(np.eye(4), START_NS + i * PERIOD_NS)
        wheels.send_around(seen.stamp_ns)
        probe.spin_for(0.05)
        peer.answer_to(features_msg(seen))
    buffer = PoseBuffer()
    for msg in peer.tf:
        for edge in msg.transforms:
            if edge.header.frame_id == 'map':
                stamp_ns = conversions.stamp_from_msg(edge.header.stamp)
                buffer.add(stamp_ns, conversions.transform_from_msg(edge))

    def error_m(stamp_ns: int) -> float:
        T_map_odom = buffer.at(stamp_ns)
        assert T_map_odom is not None
        return float(np.linalg.norm((T_map_odom @ wheels.at(stamp_ns))[:3, 3]))

    slip_ns = START_NS + (IMAGES // 2) * PERIOD_NS
    assert error_m(slip_ns) == pytest.approx(0.5, abs=0.01)
    assert error_m(slip_ns + 50_000_000) < 0.01
    assert error_m(slip_ns + 80_000_000) < 0.01


def test_late_wheels_are_logged_ever_more_rarely(
    start: Start, probe: Probe, tmp_path: Path
) -> None:
    parameters = {'frames.base': 'base_link', 'frames.publish_odom_to_base': False}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer, wheels, world = Peer(probe), Wheels(probe), PointWorld()
    peer.publish_camera_mounting()
    peer.begin()
    for i in range(40):  # every other image comes 0.3 s before the transforms of the wheels
        stamp_ns = START_NS + i * 10 * PERIOD_NS
        if i % 2:
            wheels.send_around(stamp_ns)
            probe.spin_for(0.05)
        peer.answer_to(features_msg(world.features(np.eye(4), stamp_ns)))
    log = '\n'.join(path.read_text() for path in tmp_path.glob('log_*/*'))
    assert 1 <= log.count('/tf has no transform of the wheels from odom to base_link') <= 3


class GoodWheels(Wheels):
    """Wheel odometry without slip, of a robot that moves far between the last two images."""

    @staticmethod
    def at(stamp_ns: int) -> FloatArray:
        start = se3.exp(np.array([0, 0, 0.5, 5.0, 1.0, 0.0]))
        T = T_BASE_CAMERA @ displaced_at((stamp_ns - START_NS) / PERIOD_NS)
        return np.asarray(start @ T @ se3.inverse(T_BASE_CAMERA))


def displaced_at(i: float) -> FloatArray:
    """Return the (4, 4) T_world_camera of image i: at rest, and displaced in the last image."""
    twist = np.array([0.0, 0.2, 0, 0.35, 0, 0]) if i > IMAGES - 1.5 else np.zeros(6)
    return se3.exp(twist)


def test_wheel_odometry_predicts_a_large_motion(start: Start, probe: Probe) -> None:
    parameters = {'frames.base': 'base_link', 'frames.publish_odom_to_base': False}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    own = probe.collect(Odometry, 'visual_odom', wait=False)
    peer, wheels, world = Peer(probe), GoodWheels(probe), PointWorld()
    peer.publish_camera_mounting()
    peer.begin()
    for i in range(IMAGES):
        stamp_ns = START_NS + i * PERIOD_NS
        wheels.send_around(stamp_ns)
        probe.spin_for(0.05)
        status = peer.answer_to(features_msg(world.features(displaced_at(i), stamp_ns)))
        assert (status.state, status.relocalizations) == (SlamStatus.TRACKING, 0)
    expected = T_BASE_CAMERA @ displaced_at(IMAGES - 1) @ se3.inverse(T_BASE_CAMERA)
    np.testing.assert_allclose(poses(own)[-1], expected, atol=0.005)


def test_missing_wheel_odometry_is_reported(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'frames.publish_odom_to_base': False})
    peer = Peer(probe)
    peer.begin()
    peer.answer_to(features_msg(PointWorld().features(camera_at(0), START_NS)))
    assert '/tf has no transform of the wheels' in peer.diagnosis()[0]
    assert peer.edges() == set()


def test_planar_motion_without_a_base_frame_is_reported(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'frames.planar': True})
    peer = Peer(probe)
    peer.play()
    peer.probe.spin_until(
        lambda: any('frames.planar needs frames.base' in s.message for s in statuses(peer)),
        'no warning is published',
    )


def statuses(peer: Peer) -> list[Any]:
    return [status for msg in peer.diagnostics for status in msg.status]


def in_frame(msg: Any, frame_id: str) -> Any:
    msg.header.frame_id = frame_id
    return msg


def camera_info(frame_id: str) -> CameraInfo:
    header = conversions.header_to_msg(START_NS, frame_id)
    return conversions.camera_to_msg(CAMERA, header)


@pytest.mark.parametrize(
    ('frame_id', 'parameters', 'child'),
    [('/camera', {}, 'camera'), ('', {'expert': True, 'input.camera_frame': 'named'}, 'named')],
)
def test_a_slashed_or_missing_camera_frame_is_valid_in_tf(
    start: Start, probe: Probe, frame_id: str, parameters: dict[str, Any], child: str
) -> None:
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer = Peer(probe)
    peer.begin(camera_info(frame_id))
    seen = PointWorld().features(camera_at(0), START_NS)
    peer.answer_to(in_frame(features_msg(seen), frame_id))
    peer.probe.spin_until(lambda: len(peer.edges()) == 2, 'no transforms')
    assert peer.edges() == {('map', 'odom'), ('odom', child)}


def test_an_empty_camera_frame_is_refused_with_what_to_do(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = Peer(probe)
    messages: list[str] = []

    def is_named() -> bool:
        peer.send_camera(camera_info(''))
        messages[:] = [s.message for d in peer.diagnostics for s in d.status]
        return any('frame_id is empty' in message for message in messages)

    probe.spin_until(is_named, 'no diagnostics about the frame', 60.0)
    assert any('parameter input.camera_frame' in message for message in messages)
