"""Conversion of RealSense Viewer and librealsense recordings to the messages of ROS drivers.

The recordings have no frames. The pose of each stream in the device is a separate message.
librealsense 2.5x appends the depth unit (m, float32) to images without changing the type.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from rosbags.serde.errors import SerdeError

from hoid_bags.storage import bag_types as types
from hoid_bags.storage.bag_types import Message
from hoid_bags.storage.static_transforms import static_transforms
from hoid_common import se3, topics

_STREAM = re.compile(r'/(?P<device>device_\d+)/sensor_\d+/(?P<stream>[^/]+)/.*')
_PLACE = re.compile(r'.*/tf/(?P<group>\d+)')
_TRANSFORM = 'geometry_msgs/msg/Transform'
_DEPTH_UNIT = struct.Struct('<f')
_MM = 0.001

Converter = Callable[[bytes], 'bytes | memoryview']


class ViewerTopic(NamedTuple):
    """The topic of a ROS driver that corresponds to a topic of librealsense."""

    name: str
    type_name: str
    convert: Converter  # from the bytes of ROS 1 to CDR


def viewer_topic(topic: str, type_name: str) -> ViewerTopic | None:
    """Return the ROS driver's topic for a topic of librealsense; None for all other topics.

    Images, IMU and camera_info get a frame, and the poses of the streams become /tf_static.
    """
    stream = _STREAM.fullmatch(topic)
    if stream is None:
        return None
    frame = f'{stream["device"]}_{stream["stream"]}'
    place = _PLACE.fullmatch(topic)
    if place is not None and type_name == _TRANSFORM:
        parent = f'{stream["device"]}_{place["group"]}'
        return ViewerTopic(
            topics.TF_STATIC, types.TF_MESSAGE, lambda data: _static_transform(data, parent, frame)
        )
    if type_name == types.IMAGE:
        return ViewerTopic(topic, types.IMAGE, lambda data: _image(data, frame))
    if type_name in (types.CAMERA_INFO, types.IMU):
        return ViewerTopic(topic, type_name, lambda data: _with_frame(data, type_name, frame))
    return None


def _from_ros1(data: bytes, type_name: str) -> Message:
    return types.deserialize(types.shared_typestore().ros1_to_cdr(data, type_name), type_name)


def _with_frame(data: bytes, type_name: str, frame: str) -> memoryview:
    message = _from_ros1(data, type_name)
    message.header.frame_id = frame
    # "Brown Conrady", "Inverse Brown Conrady", ...: the ROS driver calls all plumb_bob.
    if type_name == types.CAMERA_INFO and 'Brown Conrady' in message.distortion_model:
        message.distortion_model = 'plumb_bob'
    return types.serialize(message, type_name)


def _image(data: bytes, frame: str) -> memoryview:
    """Return the image with a frame; depth in another unit than millimeters becomes 32FC1 (m)."""
    unit_m = 0.0
    try:
        message = _from_ros1(data, types.IMAGE)
    except SerdeError:
        message = _from_ros1(data[: -_DEPTH_UNIT.size], types.IMAGE)
        (unit_m,) = _DEPTH_UNIT.unpack(data[-_DEPTH_UNIT.size :])
    message.header.frame_id = frame
    is_mm = not 0 < unit_m < 1 or abs(unit_m - _MM) < 1e-3 * _MM
    if message.encoding == 'mono16' and not is_mm:
        depth_m = message.data.view('<u2').astype(np.float32) * np.float32(unit_m)
        message.encoding, message.step = '32FC1', 2 * message.step
        message.data = depth_m.view(np.uint8)
    return types.serialize(message, types.IMAGE)


def _static_transform(data: bytes, parent: str, child: str) -> memoryview:
    """Return the /tf_static message with a stream's pose.

    librealsense records the transform of device points to the stream: T_stream_device.
    """
    place = _from_ros1(data, _TRANSFORM)
    q, t = place.rotation, place.translation
    T_parent_child = se3.inverse(
        se3.from_quat_translation(np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z]))
    )
    return types.serialize(static_transforms((parent, child, T_parent_child)), types.TF_MESSAGE)
