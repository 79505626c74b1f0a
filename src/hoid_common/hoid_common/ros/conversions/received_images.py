"""Deserialization of sensor_msgs/Image without the two copies of rclpy, 1 ms for a VGA image."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

from builtin_interfaces.msg import Time
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.values import ByteArray

_HEADER = 'builtin_interfaces/Time stamp\nstring frame_id'
_IMAGE = (
    'std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n'
    'uint32 step\nuint8[] data'
)
# A type store of all messages would delay the start of a node by 0.1 s.
_TYPES = get_typestore(Stores.EMPTY)
_TYPES.register(get_types_from_msg(_HEADER, 'std_msgs/msg/Header'))
_TYPES.register(get_types_from_msg(_IMAGE, 'sensor_msgs/msg/Image'))


class ReceivedImage(NamedTuple):
    """The fields of sensor_msgs/Image. `data` is a read-only view of the serialized bytes."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: ByteArray  # (step * height,); its length is not checked


def image_from_cdr(serialized: bytes) -> ReceivedImage:
    """Return the sensor_msgs/Image in serialized bytes (CDR); MessageError if they are none."""
    try:
        image = cast(
            'Any', _TYPES.deserialize_cdr(memoryview(serialized), 'sensor_msgs/msg/Image')
        )
        stamp = Time(sec=image.header.stamp.sec, nanosec=image.header.stamp.nanosec)
    except SerdeError as error:
        raise MessageError(f'{len(serialized)} bytes are no sensor_msgs/Image') from error
    return ReceivedImage(
        Header(stamp=stamp, frame_id=image.header.frame_id),
        image.height,
        image.width,
        image.encoding,
        image.is_bigendian,
        image.step,
        image.data,
    )
