"""Serialization (CDR) of paths, point clouds and keyframe markers as whole arrays.

rclpy creates and serializes an object for each pose and point, which takes 240 ms for a path of
10,000 poses and holds Python's interpreter lock. Here rclpy serializes a message without elements,
and the elements are inserted as one array, which takes 3 ms.
"""

from __future__ import annotations

import struct
from array import array
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from hoid_common import se3
from hoid_common.ros.conversions import Cloud
from hoid_common.ros.conversions.clouds import cloud_to_msg, point_table
from hoid_common.ros.conversions.slam import keyframe_lines_m, keyframe_marker
from hoid_common.values import NS_PER_S, ByteArray, FloatArray, IntArray

_HEAD_BYTES = 4  # encapsulation header; alignment in CDR counts from the next byte
_COUNT_BYTES = 4
_ALIGNMENT = 8  # alignment of float64 in bytes
_STAMP_BYTES = 12  # stamp (8 bytes), and the length of the frame's name (4 bytes)
_POSE_BYTES = 56  # seven float64: position and quaternion
_SENTINEL = 1.2345678987654321e-300  # chosen: a value that no template contains by chance


def path_to_cdr(stamps_ns: IntArray, T_map_base: FloatArray, header: Header) -> ByteArray:
    """Return the CDR bytes of a nav_msgs/Path of poses (N, 4, 4) in the header's frame."""
    one = PoseStamped(header=Header(frame_id=header.frame_id))
    position, quat = one.pose.position, one.pose.orientation
    position.x = position.y = position.z = quat.x = quat.y = quat.z = quat.w = _SENTINEL
    begin, end = _around(
        Path(header=header), Path(header=header, poses=[one]), struct.pack('<7d', *[_SENTINEL] * 7)
    )
    name = header.frame_id.encode() + b'\0'
    text_bytes = _STAMP_BYTES + len(name)
    stride = _aligned(text_bytes) + _POSE_BYTES
    layout = np.dtype(
        {
            'names': ['sec', 'nanosec', 'length', 'name', 'pose'],
            'formats': ['<i4', '<u4', '<u4', (np.uint8, len(name)), ('<f8', 7)],
            'offsets': [0, 4, 8, _STAMP_BYTES, stride - _POSE_BYTES],
            'itemsize': stride,
        }
    )
    table = np.zeros(len(stamps_ns), layout)
    table['sec'], table['nanosec'] = np.divmod(stamps_ns, NS_PER_S)
    table['length'], table['name'] = len(name), np.frombuffer(name, np.uint8)
    table['pose'][:, :3] = T_map_base[:, :3, 3]
    table['pose'][:, 3:] = se3.quat_xyzw_from_rotation(T_map_base[:, :3, :3])
    body = table.view(np.uint8).reshape(-1)
    # In each pose, padding follows the frame name, up to the first float64. The first pose begins
    # at a multiple of 4 bytes, but all later ones at a multiple of 8, so that its padding may
    # differ from theirs by 4 bytes.
    first = len(begin) + _COUNT_BYTES - _HEAD_BYTES + text_bytes
    padding = np.zeros(_aligned(first) - first, np.uint8)
    pose = _aligned(text_bytes)
    return _joined(begin, len(table), [body[:text_bytes], padding, body[pose:]], end)


def cloud_to_cdr(cloud: Cloud, header: Header) -> ByteArray:
    """Return the CDR bytes of the sensor_msgs/PointCloud2 that `cloud_to_msg` returns."""
    colors = None if cloud.colors_bgr is None else cloud.colors_bgr[:0]
    labels = None if cloud.labels is None else cloud.labels[:0]
    msg = cloud_to_msg(Cloud(cloud.points_m[:0], colors, labels), header)
    table = point_table(cloud)
    n, step = table.shape
    msg.width, msg.row_step = n, n * step
    empty = serialize_message(msg)
    sentinel = struct.pack('<d', _SENTINEL)
    msg.data = array('B', sentinel)
    begin, end = _around(empty, msg, sentinel)
    return _joined(begin, n * step, [table.reshape(-1)], end)


def keyframes_to_cdr(T_map_camera: FloatArray, header: Header) -> ByteArray:
    """Return the CDR bytes of a MarkerArray that shows keyframes (N, 4, 4) as pyramids."""
    marker = keyframe_marker(header, is_empty=len(T_map_camera) == 0)
    empty = serialize_message(MarkerArray(markers=[marker]))
    marker.points = [Point(x=_SENTINEL, y=_SENTINEL, z=_SENTINEL)]
    one = MarkerArray(markers=[marker])
    begin, end = _around(empty, one, struct.pack('<3d', *[_SENTINEL] * 3))
    points_m = keyframe_lines_m(T_map_camera).astype('<f8', copy=False)
    first = len(begin) + _COUNT_BYTES - _HEAD_BYTES
    padding = np.zeros(_aligned(first) - first, np.uint8)
    body = np.ascontiguousarray(points_m).view(np.uint8).reshape(-1)
    return _joined(begin, len(points_m), [padding, body], end)


def _around(empty: Any, one: Any, element: bytes) -> tuple[bytes, bytes]:
    """Return the CDR bytes before the length of an array, and those after its last element.

    `empty` and `one` are the message without elements and with elements. `element` is the end of
    the last element, and occurs nowhere else.
    """
    if not isinstance(empty, bytes):
        empty = serialize_message(empty)
    data = serialize_message(one)
    num_after = len(data) - data.index(element) - len(element)
    at = len(empty) - num_after
    return empty[: at - _COUNT_BYTES], empty[at:]


def _joined(begin: bytes, count: int, elements: list[ByteArray], end: bytes) -> ByteArray:
    head = np.frombuffer(begin + struct.pack('<I', count), np.uint8)
    return np.concatenate([head, *(elements if count else ()), np.frombuffer(end, np.uint8)])


def _aligned(offset: int) -> int:
    return -(-offset // _ALIGNMENT) * _ALIGNMENT
