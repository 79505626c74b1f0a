"""The transforms of one image from /tf."""

from typing import Any

from hoid_common.ros import conversions
from hoid_common.values import FloatArray

OPTICAL = 'camera_color_optical_frame'


def edges(tf: list[Any], stamp_ns: int) -> dict[tuple[str, str], FloatArray]:
    """Return the transforms of an image by parent and child frame, out of many messages."""
    return {
        (t.header.frame_id, t.child_frame_id): conversions.transform_from_msg(t)
        for message in tf
        for t in message.transforms
        if conversions.stamp_from_msg(t.header.stamp) == stamp_ns
    }
