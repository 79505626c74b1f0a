"""Conversion of the SLAM's status (hoid_msgs/SlamStatus), and of keyframes to markers."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from geometry_msgs.msg import Vector3
from hoid_msgs.msg import SlamStatus as SlamStatusMsg
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from hoid_common.errors import MessageError
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus
from hoid_common.values import FloatArray

# Half width, half height and depth of the pyramid that stands for a keyframe. Chosen to look like
# a camera of aspect ratio 4:3 in RViz.
_WIDTH_M, _HEIGHT_M, _DEPTH_M = 0.05, 0.0375, 0.05
_LINE_M = 0.003  # width of its lines
_COLOR = ColorRGBA(r=0.35, g=0.75, b=1.0, a=0.8)
_CORNERS = np.array(
    [
        [-_WIDTH_M, -_HEIGHT_M],
        [_WIDTH_M, -_HEIGHT_M],
        [_WIDTH_M, _HEIGHT_M],
        [-_WIDTH_M, _HEIGHT_M],
    ]
)
# Fields that have the same name and type in the value and in the message.
_COPIED = {field.name for field in fields(SlamStatus)} - {'state', 'mode', 'stage_ms'}


def slam_status_from_msg(msg: SlamStatusMsg) -> SlamStatus:
    """Return the status in a message; MessageError if it is malformed."""
    if len(msg.stage_names) != len(msg.stage_ms):
        raise MessageError(
            f'slam_status has {len(msg.stage_names)} stage_names and {len(msg.stage_ms)} stage_ms'
        )
    try:
        state, mode = SlamState(msg.state), SlamMode(msg.mode)
    except ValueError as error:
        raise MessageError(f'slam_status: {error}; see hoid_msgs/SlamStatus') from error
    copied = {name: getattr(msg, name) for name in _COPIED}
    stage_ms = dict(zip(msg.stage_names, msg.stage_ms, strict=True))
    return SlamStatus(state, mode, stage_ms=stage_ms, **copied)


def slam_status_to_msg(status: SlamStatus, header: Header) -> SlamStatusMsg:
    return SlamStatusMsg(
        header=header,
        state=status.state.value,
        mode=status.mode.value,
        stage_names=list(status.stage_ms),
        stage_ms=list(status.stage_ms.values()),
        **{name: getattr(status, name) for name in _COPIED},
    )


def keyframe_marker(header: Header, *, is_empty: bool) -> Marker:
    """Return the marker of the keyframes' lines without its points; an empty one is deleted."""
    marker = Marker(header=header, ns='keyframes', id=0, type=Marker.LINE_LIST)
    # RViz reports an error for an empty list of lines.
    marker.action = Marker.DELETE if is_empty else Marker.ADD
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=_LINE_M, y=0.0, z=0.0)
    marker.color = _COLOR
    return marker


def keyframe_lines_m(T_map_camera: FloatArray) -> FloatArray:
    """Return the ends (16 N, 3) in m of the lines of N keyframes (N, 4, 4) as pyramids."""
    lines_m = _pyramid_lines()
    placed = lines_m @ np.swapaxes(T_map_camera[:, :3, :3], 1, 2) + T_map_camera[:, None, :3, 3]
    return np.asarray(placed.reshape(-1, 3))


def _pyramid_lines() -> FloatArray:
    """Return the end points (16, 3) in m of a pyramid's eight lines, in the optical frame."""
    base = np.hstack([_CORNERS, np.full((4, 1), _DEPTH_M)])
    sides = np.stack([np.zeros((4, 3)), base], axis=1)
    rim = np.stack([base, np.roll(base, -1, axis=0)], axis=1)
    return np.concatenate([sides, rim]).reshape(16, 3)
