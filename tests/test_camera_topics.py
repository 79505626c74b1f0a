"""rgbd_slam accepts a camera_info that agrees with the features, and reports any other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus

from hoid_common.ros import conversions
from hoid_common.values import CameraModel
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg

TWICE = CameraModel(1280, 960, 1050.0, 1050.0, 639.5, 479.5)
WIDE = CameraModel(848, 480, 615.0, 615.0, 423.5, 239.5)  # no whole multiple of CAMERA


class Peer(SlamPeer):
    """Publishes camera infos, and the features of images of a point world."""

    def __init__(self, probe: Probe) -> None:
        super().__init__(probe)
        self.world, self.next = PointWorld(), 0

    def send_info(self, camera: CameraModel) -> None:
        header = conversions.header_to_msg(START_NS, OPTICAL)
        self.camera.publish(conversions.camera_to_msg(camera, header))

    def send(self, count: int) -> None:
        """Send the next images, each after the status of the previous one."""
        for _ in range(count):
            pose = pose_after(self.next, turn_rad=0.004)
            stamp_ns = START_NS + self.next * PERIOD_NS
            self.answer_to(features_msg(self.world.features(pose, stamp_ns)))
            self.next += 1

    def wait_for_problem(self, text: str) -> None:
        self.probe.spin_until(lambda: text in self.diagnosis()[0], f'"{text}" is not reported')

    def wait_for_no_problem(self, text: str) -> None:
        self.probe.spin_until(lambda: text not in self.diagnosis()[0], f'"{text}" is not cleared')

    def wait_for_start(self) -> None:
        """Wait until the node has restarted: it then publishes a status without images."""
        before = len(self.status)
        self.probe.spin_until(lambda: len(self.status) > before, 'the node does not restart', 30)


@pytest.fixture
def peer(start: Start, probe: Probe) -> Peer:
    """Return a peer of a running node."""
    start('rgbd_slam', 'rgbd_slam_node')
    return Peer(probe)


def test_the_right_camera_info_replaces_a_first_one_of_another_size(peer: Peer) -> None:
    header = conversions.header_to_msg(START_NS, OPTICAL)
    peer.begin(conversions.camera_to_msg(WIDE, header))
    for i in range(3):
        stamp_ns = START_NS + i * PERIOD_NS
        peer.features.publish(features_msg(peer.world.features(np.eye(4), stamp_ns)))
        peer.wait_for_count('features refused', i + 1)
    peer.wait_for_problem('camera_info is of 848x480 px, images are of 640x480 px')
    peer.send_info(CAMERA)
    peer.wait_for_start()
    check_tracking(peer)
    peer.wait_for_no_problem('camera_info is of')


def test_a_first_camera_info_of_twice_the_size_is_scaled_until_the_right_one_comes(
    peer: Peer,
) -> None:
    header = conversions.header_to_msg(START_NS, OPTICAL)
    peer.begin(conversions.camera_to_msg(TWICE, header))
    peer.send(1)
    peer.wait_for_problem('it is scaled to them')
    peer.send_info(CAMERA)
    peer.wait_for_no_problem('it is scaled to them')
    check_tracking(peer)
    assert 'features refused' not in peer.diagnosis()[1]


def check_tracking(peer: Peer) -> None:
    """Send 20 images, and check how far the camera has moved."""
    first = peer.next
    peer.send(20)
    assert peer.status[-1].state == SlamStatus.TRACKING
    stamps_ns = [START_NS + i * PERIOD_NS for i in (first, first + 19)]
    T_first, T_last = (peer.pose(stamp_ns) for stamp_ns in stamps_ns)
    expected_first, expected_last = (pose_after(i, turn_rad=0.004) for i in (first, first + 19))
    expected_m = np.linalg.norm((np.linalg.inv(expected_first) @ expected_last)[:3, 3])
    moved_m = np.linalg.norm((np.linalg.inv(T_first) @ T_last)[:3, 3])
    assert moved_m == pytest.approx(expected_m, abs=0.004)


def test_a_stray_camera_info_is_reported_until_the_right_one_returns(peer: Peer) -> None:
    peer.begin()
    peer.send(35)
    for stray, message in (
        (TWICE, 'camera_info has changed from 640x480 px, fx 525.0'),
        (replace(CAMERA, fx_px=700.0), 'to 640x480 px, fx 700.0'),
    ):
        peer.send_info(stray)
        peer.wait_for_problem(message)
        peer.send(3)
        assert peer.status[-1].state == SlamStatus.TRACKING
        peer.send_info(CAMERA)
        peer.wait_for_no_problem(message)


def test_a_camera_info_of_another_frame_is_reported_until_the_right_one_returns(
    peer: Peer,
) -> None:
    peer.begin()
    peer.send(3)
    header = conversions.header_to_msg(START_NS, 'other_optical_frame')
    peer.camera.publish(conversions.camera_to_msg(CAMERA, header))
    problem = 'camera_info: of frame "other_optical_frame", but the map was begun with'
    peer.wait_for_problem(problem)
    peer.send(3)
    assert peer.status[-1].state == SlamStatus.TRACKING
    peer.send_info(CAMERA)
    peer.wait_for_no_problem(problem)


@pytest.mark.parametrize(
    'fields', [{'k': [1e-300, 0, 1, 0, 1e-300, 1, 0, 0, 1]}, {'width': 2**31}]
)
def test_an_impossible_camera_info_is_refused(peer: Peer, fields: dict[str, object]) -> None:
    header = conversions.header_to_msg(START_NS, OPTICAL)
    msg = conversions.camera_to_msg(CAMERA, header)
    for name, value in fields.items():
        setattr(msg, name, value)
    peer.camera.publish(msg)
    peer.probe.spin_until(
        lambda: peer.diagnosis()[1].get('camera infos refused') == '1',
        'the camera info is not refused',
    )
    peer.begin()
    peer.send(10)
    assert peer.status[-1].state == SlamStatus.TRACKING
