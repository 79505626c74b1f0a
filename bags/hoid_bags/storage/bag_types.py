"""Message types without ROS: the types of Jazzy, and those with a .msg file.

Such files are searched for in installed packages and in the source folder of this suite.
"""

from __future__ import annotations

import os
import re
import sys
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.serde.errors import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from hoid_common.errors import InputError, MessageError, prefixed, replaced_by

Message: TypeAlias = Any
"""Message object of rosbags' type store, which generates the classes at run time."""

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
IMU = 'sensor_msgs/msg/Imu'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
DETECTION_ARRAY = 'hoid_msgs/msg/DetectionArray'
TF_MESSAGE = 'tf2_msgs/msg/TFMessage'

EXTRINSICS = 'realsense2_camera_msgs/msg/Extrinsics'
RGBD = 'realsense2_camera_msgs/msg/RGBD'
FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'
# Definitions of message types of drivers, whose packages need not be installed then.
_FOREIGN = {
    EXTRINSICS: 'float64[9] rotation\nfloat64[3] translation',
    RGBD: (
        'std_msgs/Header header\nsensor_msgs/CameraInfo rgb_camera_info\n'
        'sensor_msgs/CameraInfo depth_camera_info\nsensor_msgs/Image rgb\nsensor_msgs/Image depth'
    ),
    FFMPEG_PACKET: (
        'std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\n'
        'uint8 flags\nbool is_bigendian\nuint8[] data'
    ),
    COMPRESSED_VIDEO: (
        'builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format'
    ),
}
_NAME = re.compile(r'[A-Za-z]\w{0,99}', re.ASCII)  # name of a package or message
_WORKSPACE_SOURCES = Path(__file__).resolve().parents[3] / 'src'


@lru_cache
def shared_typestore() -> Typestore:
    """Return the type store of this process, to which `ensure_type` adds types."""
    return get_typestore(Stores.ROS2_JAZZY)


def ensure_type(type_name: str) -> None:
    """Add a type such as `hoid_msgs/msg/Detection`, with its fields' types, to the type store.

    InputError: there is no .msg file of this name, or it cannot be parsed.
    """
    store = shared_typestore()
    if type_name in store.fielddefs:
        return
    path: Path | str = type_name
    if (text := _FOREIGN.get(type_name)) is None:
        path = _find_definition(type_name)
        text = path.read_text(encoding='utf-8')
    with prefixed(f'{path}: not a message definition: ', InputError, TypesysError):
        types = get_types_from_msg(text, type_name)
        for contained in sorted(named_types(types[type_name][1]) - {type_name}):
            ensure_type(contained)
        store.register(types)


def new_message(type_name: str, /, **fields: Any) -> Message:
    """Return a message of a type; arrays of numbers are NumPy arrays (N,)."""
    ensure_type(type_name)
    return shared_typestore().types[type_name](**fields)


def serialize(message: Message, type_name: str) -> memoryview:
    """Return the CDR bytes of a message whose type is known (see `ensure_type`)."""
    return shared_typestore().serialize_cdr(message, type_name)


def deserialize(data: bytes | memoryview, type_name: str) -> Message:
    """Return the message in CDR bytes; arrays in it share the memory of the bytes.

    MessageError: the bytes are no message of this type. InputError as in `ensure_type`.
    """
    ensure_type(type_name)
    with replaced_by(MessageError(f'{len(data)} bytes are no {type_name}'), SerdeError):
        return shared_typestore().deserialize_cdr(data, type_name)


def message_class(topic: str, type_name: str) -> Any:
    """Return rclpy's class of a type; InputError if its package is not built or sourced."""
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise InputError(
            f'topic "{topic}" has type "{type_name}", which is not known here;'
            ' build and source its package, or choose other topics with --topics'
        ) from error


def named_types(fields: Any) -> set[str]:
    """Return the names of all message types in a definition's fields and arrays."""
    found: set[str] = set()
    for _, (node, detail) in fields:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            found |= named_types([('', detail[0])])
        elif node == Nodetype.NAME:
            found.add(detail)
    return found


def _find_definition(type_name: str) -> Path:
    """Return the .msg file of a type; raise InputError if it is not found."""
    package, _, name = type_name.partition('/msg/')
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    shares = [Path(prefix) / 'share' for prefix in (*prefixes, sys.prefix)]
    for folder in (*shares, _WORKSPACE_SOURCES):
        path = folder / package / 'msg' / f'{name}.msg'
        # Names with other characters could lead out of the folder.
        if _NAME.fullmatch(package) and _NAME.fullmatch(name) and path.is_file():
            return path
    raise InputError(
        f'message type "{type_name}" is not known here; build and source its package, or leave'
        ' its topic out'
    )
