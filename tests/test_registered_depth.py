"""Depth in its own camera, live: mapped to color by camera_info and /tf_static, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from hoid_common import se3
from hoid_common.inputs.registration import Registration
from hoid_common.ros import conversions, qos
from hoid_common.values import CameraModel, Float32Array
from hoid_system_tests.filter_peer import CAMERA, FRAME, IMAGE, PERIOD_NS, START_NS, FilterRunner
from hoid_system_tests.filter_peer import Peer as FilterPeer
from hoid_system_tests.probe import Probe

DEPTH = CameraModel(320, 180, 190.0, 190.0, 159.5, 89.5)
DEPTH_FRAME = 'camera_depth_optical_frame'
T_COLOR_DEPTH = se3.from_quat_translation(
    np.array([0.004, -0.006, 0.003, 1.0]), np.array([0.015, -0.001, 0.002])
)
DEPTH_M = (np.round(1000 + 2 * (np.arange(180 * 320) % 320)) / 1000).astype(np.float32)
DEPTH_M = DEPTH_M.reshape(180, 320)


def send(peer: FilterPeer, i: int, depth_m: Float32Array, frame: str) -> None:
    """Publish the images of frame i, with depth in a frame of its own."""
    peer.send_boxes(i)
    peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(i)))
    header = conversions.header_to_msg(START_NS + i * PERIOD_NS, frame)
    peer.depth.publish(conversions.depth_to_msg(depth_m, header))


def test_depth_of_another_camera_is_mapped_once_its_place_is_known(
    run_filter: FilterRunner, probe: Probe
) -> None:
    peer = run_filter(strategy='person')
    depths = probe.collect(Image, 'hoid_filter/static_depth')
    probe.spin_for(0.5)
    send(peer, 0, DEPTH_M, DEPTH_FRAME)
    peer.wait_for_count('matched images refused', 1)
    infos = probe.publisher(CameraInfo, 'depth/camera_info')
    header = conversions.header_to_msg(START_NS, DEPTH_FRAME)
    infos.publish(conversions.camera_to_msg(DEPTH, header))
    frames = probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    edge = conversions.transform_to_msg(T_COLOR_DEPTH, START_NS, FRAME, DEPTH_FRAME)
    frames.publish(TFMessage(transforms=[edge]))
    peer.wait_for_count('camera infos of depth received', 1)
    probe.spin_for(0.5)
    send(peer, 1, DEPTH_M, DEPTH_FRAME)
    probe.spin_until(lambda: bool(depths), 'no depth')
    assert depths[0].header == peer.header(1)
    expected_m = Registration(DEPTH, CAMERA, T_COLOR_DEPTH)(DEPTH_M)
    np.testing.assert_allclose(conversions.depth_from_msg(depths[0]), expected_m, atol=1e-6)
    assert (expected_m > 0).mean() > 0.4


def test_depth_of_half_the_size_in_the_frame_of_color_is_used(
    run_filter: FilterRunner, probe: Probe
) -> None:
    peer = run_filter(strategy='person')
    depths = probe.collect(Image, 'hoid_filter/static_depth')
    probe.spin_for(0.5)
    half_m = (np.arange(240 * 320).reshape(240, 320) % 3000 / 1000 + 1).astype(np.float32)
    send(peer, 0, half_m, FRAME)
    probe.spin_until(lambda: bool(depths), 'no depth')
    expected_m = np.kron(half_m, np.ones((2, 2), np.float32))
    np.testing.assert_allclose(conversions.depth_from_msg(depths[0]), expected_m, atol=1e-6)


@pytest.mark.parametrize('size', [(240, 320), (480, 640)])
def test_depth_that_is_not_registered_is_said(
    run_filter: FilterRunner, size: tuple[int, int]
) -> None:
    peer = run_filter(strategy='person')
    send(peer, 0, np.full(size, 2.0, np.float32), DEPTH_FRAME)
    expected = (
        'depth is not registered to color: its frame is camera_depth_optical_frame, that of color '
        'camera_color_optical_frame; let the driver register it, or publish camera_info'
    )
    peer.probe.spin_until(lambda: expected in peer.newest_diagnosis()[0], 'nothing is said')
    if size == (480, 640):
        peer.answer()
    else:
        peer.wait_for_count('matched images refused', 1)


def test_a_camera_info_of_twice_the_size_is_scaled(run_filter: FilterRunner) -> None:
    peer = run_filter(strategy='hoid2d')
    twice = CAMERA.scaled_to((1280, 960))
    assert twice is not None
    peer.camera.publish(conversions.camera_to_msg(twice, peer.header(0)))
    peer.wait_for_count('camera infos received', 2)
    peer.show(0, ('person', (100.0, 50.0, 300.0, 450.0)))
    _, objects = peer.answer()
    expected = [(200 - 320) / 500 * 2, (250 - 240) / 500 * 2, 2.0]
    assert list(objects.objects[0].center_camera_m) == pytest.approx(expected, abs=0.02)
