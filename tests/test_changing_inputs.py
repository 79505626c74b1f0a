"""What changes while nodes run: frames that never come, the resolution, and simulated time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from hoid_common import se3
from hoid_common.ros import conversions, qos
from hoid_common.values import CameraModel, FloatArray
from hoid_system_tests.filter_peer import IMAGE, PERSON, FilterRunner
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer

pytestmark = pytest.mark.thorough

HALF_PX = 320, 240
HALF = CameraModel(*HALF_PX, 262.5, 262.5, 159.5, 119.5)
NUM_TRIAL = 30  # images after which a map keeps its calibration
REPLAY_NS = 600_000_000_000  # by which a simulator goes back


class Peer(SlamPeer):
    """Publishes the features of images of a point world, of any size."""

    def __init__(self, probe: Probe) -> None:
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        super().__init__(probe)
        self.world = PointWorld()

    def message(self, i: int, stamp_ns: int, size_px: tuple[int, int]) -> FeaturesMsg:
        features = self.world.features(pose_after(i, turn_rad=0.004), stamp_ns)
        scale = np.float32(size_px[0] / CAMERA.width_px)
        features = replace(features, uv_px=scale * (features.uv_px + 0.5) - 0.5)
        header = conversions.header_to_msg(stamp_ns, OPTICAL)
        return conversions.features_to_msg(features, header, size_px)

    def send(
        self, first: int, count: int, start_ns: int = START_NS, *, is_half: bool = False
    ) -> None:
        """Send images, each after the status of the previous one."""
        for i in range(first, first + count):
            size_px = HALF_PX if is_half else CAMERA.size_px
            self.answer_to(self.message(i, start_ns + i * PERIOD_NS, size_px))

    def send_info(self, camera: CameraModel) -> None:
        header = conversions.header_to_msg(START_NS, OPTICAL)
        self.camera.publish(conversions.camera_to_msg(camera, header))

    def moved(self, first_ns: int, last_ns: int) -> FloatArray:
        """Return the motion (4, 4) between two images, by odometry."""
        self.probe.spin_until(lambda: last_ns in self._poses(), 'odometry is missing')
        poses = self._poses()
        return np.asarray(se3.inverse(poses[first_ns]) @ poses[last_ns])

    def _poses(self) -> dict[int, FloatArray]:
        return {
            conversions.stamp_from_msg(m.header.stamp): conversions.pose_from_msg(m.pose.pose)
            for m in self.odom
        }


def expected(first: int, last: int) -> FloatArray:
    poses = [pose_after(i, turn_rad=0.004) for i in (first, last)]
    return np.asarray(se3.inverse(poses[0]) @ poses[1])


def moved_m(T: FloatArray) -> float:
    return float(np.linalg.norm(T[:3, 3]))


def test_without_its_base_frame_slam_waits_and_says_so(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'frames.base': 'base_link'})
    peer = Peer(probe)
    peer.send_camera()
    probe.spin_for(0.5)
    for i in range(20):
        peer.features.publish(peer.message(i, START_NS + i * PERIOD_NS, CAMERA.size_px))
        probe.spin_for(0.05)
    peer.wait_for_count('features before camera and base were known', 20)
    message, _ = peer.diagnosis()
    assert 'does not join' in message
    assert 'base_link' in message
    assert (peer.odom, peer.tf) == ([], [])


def test_a_resolution_that_changes_is_refused_until_a_reset(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = Peer(probe)
    peer.begin()
    peer.send(0, NUM_TRIAL + 5)
    peer.send_info(HALF)
    for i in range(5):
        stamp_ns = START_NS + (NUM_TRIAL + 5 + i) * PERIOD_NS
        peer.features.publish(peer.message(NUM_TRIAL + 5 + i, stamp_ns, HALF_PX))
        peer.wait_for_count('features refused', i + 1)
    message, _ = peer.diagnosis()
    assert 'camera_info has changed from 640x480 px, fx 525.0' in message
    assert 'to 320x240 px, fx 262.5' in message
    peer.send_info(CAMERA)  # the old resolution again: the map goes on
    probe.spin_for(0.3)
    peer.send(NUM_TRIAL + 10, 5)
    assert peer.status[-1].state == SlamStatus.TRACKING
    last_ns = START_NS + (NUM_TRIAL + 14) * PERIOD_NS
    assert moved_m(peer.moved(START_NS, last_ns)) == pytest.approx(
        moved_m(expected(0, NUM_TRIAL + 14)), abs=0.01
    )
    peer.send_info(HALF)
    probe.spin_for(0.3)
    assert probe.call(Trigger, 'rgbd_slam/reset', Trigger.Request()).success
    peer.send(100, 20, is_half=True)
    assert peer.status[-1].state == SlamStatus.TRACKING
    stamps_ns = [START_NS + i * PERIOD_NS for i in (100, 119)]
    np.testing.assert_allclose(peer.moved(*stamps_ns), expected(100, 119), atol=0.004)


def test_simulated_time_that_starts_anew_begins_a_new_map(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'use_sim_time': True})
    clock = probe.publisher(Clock, '/clock', qos.CLOCK)
    peer = Peer(probe)
    peer.begin()
    for start_ns in (START_NS, START_NS - REPLAY_NS):
        for i in range(20):
            clock.publish(Clock(clock=conversions.stamp_to_msg(start_ns + i * PERIOD_NS)))
            peer.send(i, 1, start_ns)
        assert peer.status[-1].state == SlamStatus.TRACKING
        stamps_ns = [start_ns, start_ns + 19 * PERIOD_NS]
        np.testing.assert_allclose(peer.moved(*stamps_ns), expected(0, 19), atol=0.004)


@pytest.mark.parametrize('is_restart', [False, True])
def test_the_filter_goes_on_with_another_resolution_or_time(
    run_filter: FilterRunner, *, is_restart: bool
) -> None:
    peer = run_filter()
    peer.show(0, PERSON)
    features, objects = peer.answer()
    assert (features.image_width, features.image_height) == (640, 480)
    assert list(objects.objects[0].center_camera_m)[2] == pytest.approx(2.0, abs=0.02)
    if is_restart:
        peer.show(-18_000, PERSON)
        features, objects = peer.answer(2)
        assert features.header == peer.header(-18_000)
        assert (features.image_width, features.image_height) == (640, 480)
        assert list(objects.objects[0].center_camera_m)[2] == pytest.approx(2.0, abs=0.02)
        return
    half: Any = cv2.resize(IMAGE, HALF_PX)
    camera = CameraModel(*HALF_PX, 250.0, 250.0, 159.75, 119.75)
    for _ in range(3):
        peer.camera.publish(conversions.camera_to_msg(camera, peer.header(1)))
    peer.wait_for_count('camera infos received', 4)
    left, top, right, bottom = (x / 2 for x in PERSON[1])
    peer.send_images(1, np.full((240, 320), 3.0, np.float32), half)
    peer.probe.spin_for(0.2)  # less than detections.wait_s, after which the verdict is final
    peer.send_boxes(1, ('person', (left, top, right, bottom)), image_width=320, image_height=240)
    features, objects = peer.answer(2)
    assert (features.image_width, features.image_height) == HALF_PX
    expected_m = [(100 - 159.75) / 250 * 3, (125 - 119.75) / 250 * 3, 3.0]
    assert list(objects.objects[0].center_camera_m) == pytest.approx(expected_m, abs=0.03)
