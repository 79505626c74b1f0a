"""Recordings whose depth is in its own camera: mapped to color by what the bag says of both."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.sequence import open_sequence
from hoid_bags.storage.bag_types import (
    CAMERA_INFO,
    EXTRINSICS,
    IMAGE,
    TF_MESSAGE,
    Message,
    new_message,
)
from hoid_bags.storage.static_transforms import static_transforms, transform
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.inputs.registration import Registration
from hoid_common.values import CameraModel

from .ros1_bags import ros1_copy

COLOR = CameraModel(64, 48, 60.0, 60.0, 31.0, 24.0)
DEPTH = CameraModel(42, 24, 21.0, 21.0, 20.5, 11.5)
T_COLOR_DEPTH = se3.from_quat_translation(
    np.array([0.004, -0.006, 0.003, 1.0]), np.array([0.015, -0.001, 0.002])
)
DEPTH_MM = (1000 + 3 * np.arange(24 * 42) % 700).reshape(24, 42).astype(np.uint16)
EXPECTED_M = Registration(DEPTH, COLOR, T_COLOR_DEPTH)((DEPTH_MM / 1000).astype(np.float32))
DEPTH_FRAME, BODY = 'camera_depth_optical_frame', 'camera_link'


def with_frame(message: Message, frame: str) -> Message:
    message.header.frame_id = frame
    return message


def write(path: Path, *, place: str, info: bool = True, small: bool = False) -> Path:
    """Write a recording of realsense2_camera without align_depth.

    Args:
        path: The bag.
        place: How the bag says where the depth camera is: 'tf', 'extrinsics' or ''.
        info: Whether it has the camera_info of depth.
        small: Whether the color image has exactly twice the size of depth.
    """
    color, depth = '/camera/camera/color/image_raw', '/camera/camera/depth/image_rect_raw'
    camera = CameraModel(84, 48, 80.0, 80.0, 41.0, 24.0) if small else COLOR
    pixels = np.full((camera.height_px, camera.width_px, 3), 90, np.uint8)
    messages = [
        (color, IMAGE, bag_messages.image(10**9, pixels, 'rgb8')),
        (depth, IMAGE, with_frame(bag_messages.image(10**9, DEPTH_MM, '16UC1'), DEPTH_FRAME)),
        ('/camera/camera/color/camera_info', CAMERA_INFO, bag_messages.camera_info(1, camera)),
    ]
    if info:
        message = with_frame(bag_messages.camera_info(1, DEPTH), DEPTH_FRAME)
        messages.append(('/camera/camera/depth/camera_info', CAMERA_INFO, message))
    if place == 'tf':
        T_body_color = se3.from_quat_translation(np.array([0.5, -0.5, 0.5, -0.5]), np.ones(3))
        frames = static_transforms(
            (BODY, bag_messages.CAMERA_FRAME, T_body_color),
            (f'/{BODY}', DEPTH_FRAME, T_body_color @ T_COLOR_DEPTH),
        )
        messages.append(('/tf_static', TF_MESSAGE, frames))
    elif place:
        R, t = T_COLOR_DEPTH[:3, :3], T_COLOR_DEPTH[:3, 3].copy()
        message = new_message(EXTRINSICS, rotation=R.T.ravel(), translation=t)
        messages.append(('/camera/camera/extrinsics/depth_to_color', EXTRINSICS, message))
    with BagWriter(path) as writer:
        for i, (topic, type_name, message) in enumerate(messages):
            writer.add_topic(topic, type_name)
            writer.write(topic, i + 1, message)
    return path


@pytest.mark.parametrize('place', ['tf', 'extrinsics'])
@pytest.mark.parametrize('small', [True, False])
def test_depth_of_a_realsense_without_align_depth_is_mapped(
    place: str, small: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sequence = open_sequence(write(tmp_path / 'bag', place=place, small=small))
    (frame,) = sequence
    assert sequence.fault is None
    expected_m = EXPECTED_M
    if small:
        mapping = Registration(DEPTH, sequence.camera, T_COLOR_DEPTH)
        expected_m = mapping((DEPTH_MM / 1000).astype(np.float32))
    np.testing.assert_allclose(frame.depth_m, expected_m, atol=1e-5)
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert 'is not registered to color' in record.message
    assert 'it is mapped there' in record.message


@pytest.mark.parametrize(('place', 'info'), [('', True), ('tf', False), ('', False)])
def test_depth_whose_place_is_unknown_is_refused(place: str, info: bool, tmp_path: Path) -> None:
    for small in (False, True):
        path = write(tmp_path / f'bag{small}', place=place, info=info, small=small)
        with pytest.raises(
            InputError,
            match=r'depth is not registered to color: .*; register it in the driver, record the '
            r'camera_info of depth and /tf_static',
        ):
            list(open_sequence(path))


def test_a_recording_of_realsense_viewer_is_mapped(tmp_path: Path) -> None:
    color, depth = '/device_0/sensor_1/Color_0', '/device_0/sensor_0/Depth_0'
    pixels = np.full((48, 64, 3), 90, np.uint8)
    # librealsense records the places of the streams as T_stream_device; the device is depth.
    with BagWriter(tmp_path / 'bag') as writer:
        for i, (topic, type_name, message) in enumerate(
            (
                (f'{color}/image/data', IMAGE, bag_messages.image(10**9, pixels, 'rgb8')),
                (f'{depth}/image/data', IMAGE, bag_messages.image(10**9, DEPTH_MM, 'mono16')),
                (f'{color}/info/camera_info', CAMERA_INFO, bag_messages.camera_info(0, COLOR)),
                (f'{depth}/info/camera_info', CAMERA_INFO, bag_messages.camera_info(0, DEPTH)),
                (f'{color}/tf/0', 'geometry_msgs/msg/Transform', transform(T_COLOR_DEPTH)),
                (f'{depth}/tf/0', 'geometry_msgs/msg/Transform', transform(np.eye(4))),
            )
        ):
            writer.add_topic(topic, type_name)
            writer.write(topic, i + 1, message)
    sequence = open_sequence(ros1_copy(tmp_path / 'bag', tmp_path / 'viewer.bag', 'lz4', 0.001))
    (frame,) = sequence
    assert sequence.camera == COLOR
    np.testing.assert_allclose(frame.depth_m, EXPECTED_M, atol=1e-5)
