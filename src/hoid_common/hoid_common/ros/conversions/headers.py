"""Conversion of stamps and headers."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.values import NS_PER_S


def stamp_to_msg(stamp_ns: int) -> Time:
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    return Header(stamp=stamp_to_msg(stamp_ns), frame_id=frame_id)


def camera_frame(header: Header, default: str) -> str:
    """Return the frame of a header, or else the default, or MessageError; no leading slash."""
    frame: str = header.frame_id.lstrip('/') or default
    if not frame:
        raise MessageError(
            'frame_id is empty, so the camera has no place in TF: set it in the driver, or name '
            'the frame with the parameter input.camera_frame'
        )
    return frame
