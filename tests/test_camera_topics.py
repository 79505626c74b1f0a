"""rgbd_slam believes a camera_info when the features agree with it, and says when they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus

from hoid_common.ros import conversions
from hoid_common.values import CameraModel
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld, walked
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import NO_SCENE, PERIOD_NS, START_NS, SlamPeer, features_msg

TWICE = CameraModel(1280, 960, 1050.0, 1050.0, 639.5, 479.5)


class Peer(SlamPeer):
    """Sends cameras and images of a world of points."""

    def __init__(self, probe: Probe) -> None:
        super().__init__(probe)
        self.world, self.next = PointWorld(), 0

    def say(self, camera: CameraModel) -> None:
        header = conversions.header_to_msg(START_NS, OPTICAL)
        self.camera.publish(conversions.camera_to_msg(camera, header))

    def send(self, count: int) -> None:
        """Send the next images, each when the one before has been answered."""
        for _ in range(count):
            pose = walked(self.next, turn_rad=0.004)
            stamp_ns = START_NS + self.next * PERIOD_NS
            self.answer_to(features_msg(self.world.features(pose, stamp_ns)))
            self.next += 1

    def wait_for_problem(self, text: str) -> None:
        self.probe.spin_until(lambda: text in self.diagnosis()[0], f'"{text}" is not said')

    def wait_for_no_problem(self, text: str) -> None:
        self.probe.spin_until(lambda: text not in self.diagnosis()[0], f'"{text}" stays')

    def wait_for_start(self) -> None:
        """Wait until the node has begun anew, which it says with a status of no images."""
        before = len(self.status)
        self.probe.spin_until(lambda: len(self.status) > before, 'it does not begin anew', 30)


@pytest.fixture
def peer(start: Start, probe: Probe) -> Peer:
    """Return a peer of a running node."""
    start('rgbd_slam', 'rgbd_slam_node', NO_SCENE)
    return Peer(probe)


def test_a_first_camera_of_twice_the_size_gives_way_to_the_right_one(peer: Peer) -> None:
    header = conversions.header_to_msg(START_NS, OPTICAL)
    peer.begin(conversions.camera_to_msg(TWICE, header))
    for i in range(3):
        stamp_ns = START_NS + i * PERIOD_NS
        peer.features.publish(features_msg(peer.world.features(np.eye(4), stamp_ns)))
    peer.wait_for_problem('camera_info is of 1280x960 px, images are of 640x480 px')
    assert peer.diagnosis()[1]['features refused'] == '3'
    peer.say(CAMERA)
    peer.wait_for_start()
    peer.send(20)
    assert peer.status[-1].state == SlamStatus.TRACKING
    expected = walked(19, turn_rad=0.004)
    T_first, T_last = peer.pose(START_NS), peer.pose(START_NS + 19 * PERIOD_NS)
    moved = np.linalg.norm((np.linalg.inv(T_first) @ T_last)[:3, 3])
    assert moved == pytest.approx(np.linalg.norm(expected[:3, 3]), abs=0.004)
    peer.wait_for_no_problem('camera_info is of')


def test_a_stray_camera_is_said_and_forgotten_again(peer: Peer) -> None:
    peer.begin()
    peer.send(35)
    for stray, said in (
        (TWICE, 'camera_info is of 1280x960 px'),
        (replace(CAMERA, fx_px=700.0), 'the camera changed'),
    ):
        peer.say(stray)
        peer.wait_for_problem(said)
        peer.send(3)
        assert peer.status[-1].state == SlamStatus.TRACKING
        peer.say(CAMERA)
        peer.wait_for_no_problem(said)


@pytest.mark.parametrize(
    'fields', [{'k': [1e-300, 0, 1, 0, 1e-300, 1, 0, 0, 1]}, {'width': 2**31}]
)
def test_a_camera_that_cannot_be_changes_nothing(peer: Peer, fields: dict[str, object]) -> None:
    header = conversions.header_to_msg(START_NS, OPTICAL)
    msg = conversions.camera_to_msg(CAMERA, header)
    for name, value in fields.items():
        setattr(msg, name, value)
    peer.camera.publish(msg)
    peer.probe.spin_until(
        lambda: peer.diagnosis()[1].get('camera infos refused') == '1', 'it is not refused'
    )
    peer.begin()
    peer.send(10)
    assert peer.status[-1].state == SlamStatus.TRACKING
