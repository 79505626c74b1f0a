"""Conversion of the SLAM's status, of poses of keyframes and images, and of keyframe markers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3
from hoid_msgs.msg import KeyframePoses as KeyframePosesMsg
from hoid_msgs.msg import SlamStatus as SlamStatusMsg
from hoid_msgs.msg import TrackedImage as TrackedImageMsg
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from hoid_common import se3
from hoid_common.errors import ConfigError, MessageError, prefixed
from hoid_common.messages import stamp_from_msg
from hoid_common.poses.keyframe_poses import (
    KeyframePoses,
    LoadedKeyframes,
    SessionKeyframes,
    TrackedImage,
)
from hoid_common.ros.conversions.arrays import array_field
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus
from hoid_common.values import CameraModel, FloatArray

# Half width, half height and depth of the pyramid that shows a keyframe. Chosen to look like a
# camera of aspect ratio 4:3 in RViz.
_WIDTH_M, _HEIGHT_M, _DEPTH_M = 0.05, 0.0375, 0.05
_LINE_M = 0.003  # width of the pyramid's lines
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
_ROWS = 12  # numbers of the first three rows of a transform


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
    """Return the line-list marker of the keyframes, without points; DELETE if `is_empty`."""
    marker = Marker(header=header, ns='keyframes', id=0, type=Marker.LINE_LIST)
    # RViz reports an error for an empty list of lines.
    marker.action = Marker.DELETE if is_empty else Marker.ADD
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=_LINE_M, y=0.0, z=0.0)
    marker.color = _COLOR
    return marker


def keyframe_lines_m(T_map_camera: FloatArray) -> FloatArray:
    """Return the line ends (16 N, 3) in m of the pyramids of keyframes (N, 4, 4), in the map."""
    lines_m = _pyramid_lines()
    placed = lines_m @ np.swapaxes(T_map_camera[:, :3, :3], 1, 2) + T_map_camera[:, None, :3, 3]
    return np.asarray(placed.reshape(-1, 3))


def _pyramid_lines() -> FloatArray:
    """Return the end points (16, 3) in m of a pyramid's eight lines, in the optical frame."""
    base = np.hstack([_CORNERS, np.full((4, 1), _DEPTH_M)])
    sides = np.stack([np.zeros((4, 3)), base], axis=1)
    rim = np.stack([base, np.roll(base, -1, axis=0)], axis=1)
    return np.concatenate([sides, rim]).reshape(16, 3)


def keyframe_poses_to_msg(poses: SessionKeyframes, header: Header) -> KeyframePosesMsg:
    keyframes, loaded, camera = poses.keyframes, poses.loaded, poses.camera
    base = poses.T_camera_base
    return KeyframePosesMsg(
        **_camera_fields(camera),
        header=header,
        session=poses.session,
        is_level=poses.is_level,
        version=keyframes.version,
        uids=array_field('q', keyframes.uids),
        map_ids=array_field('q', keyframes.map_ids),
        main_map=keyframes.main_map,
        poses=array_field('d', keyframes.T_map_camera[:, :3]),
        num_loaded=loaded.number,
        source=loaded.source,
        saved_uids=array_field('q', loaded.saved_uids),
        loaded_uids=array_field('q', loaded.loaded_uids),
        camera_base=[] if base is None else array_field('d', base[:3]),
    )


def keyframe_poses_from_msg(msg: KeyframePosesMsg) -> SessionKeyframes:
    """Return the keyframe poses of a message.

    MessageError if lengths differ, uids do not ascend, a pose is not finite, or the camera is
    invalid.
    """
    uids, map_ids = np.array(msg.uids, np.int64), np.array(msg.map_ids, np.int64)
    saved, loaded = np.array(msg.saved_uids, np.int64), np.array(msg.loaded_uids, np.int64)
    rows = np.array(msg.poses, np.float64)
    if not len(uids) == len(map_ids) == len(rows) / _ROWS or len(saved) != len(loaded):
        raise MessageError(
            f'keyframe_poses has {len(uids)} uids, {len(map_ids)} map_ids, {len(rows)} numbers of '
            f'poses, {len(saved)} saved_uids and {len(loaded)} loaded_uids'
        )
    base = np.array(msg.camera_base, np.float64)
    if len(base) not in (0, _ROWS):
        raise MessageError(f'keyframe_poses has {len(base)} numbers in camera_base, not 0 or 12')
    if (np.diff(uids) <= 0).any():
        raise MessageError('keyframe_poses has uids that do not ascend')
    known = KeyframePoses(msg.version, uids, map_ids, msg.main_map, _transforms(rows))
    source = LoadedKeyframes(msg.num_loaded, msg.source, saved, loaded)
    T_camera_base = _transforms(base)[0] if len(base) else None
    camera = _camera(msg)
    return SessionKeyframes(msg.session, camera, msg.is_level, known, source, T_camera_base)


def tracked_image_to_msg(
    image: TrackedImage, session: str, T_map_keyframe: FloatArray, header: Header
) -> TrackedImageMsg:
    """Return the message of an image's pose relative to its keyframe.

    `T_map_keyframe` (4, 4) is the pose of the keyframe in the same version of the map.
    """
    T_keyframe_camera = se3.inverse(T_map_keyframe) @ image.T_map_camera
    return TrackedImageMsg(
        header=header,
        session=session,
        keyframe=image.keyframe_uid,
        pose=T_keyframe_camera[:3].ravel(),
        is_in_main_map=image.is_in_main_map,
        is_growing=image.is_growing,
    )


def tracked_image_from_msg(msg: TrackedImageMsg, T_map_keyframe: FloatArray) -> TrackedImage:
    """Return the tracked image of a message, given the present pose (4, 4) of its keyframe."""
    (T_keyframe_camera,) = _transforms(np.array(msg.pose, np.float64))
    return TrackedImage(
        stamp_from_msg(msg.header.stamp),
        T_map_keyframe @ T_keyframe_camera,
        msg.keyframe,
        msg.is_in_main_map,
        msg.is_growing,
    )


def _camera_fields(camera: CameraModel | None) -> dict[str, Any]:
    if camera is None:
        return {}
    pinhole = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    return {
        'image_width': camera.width_px,
        'image_height': camera.height_px,
        'camera': [*pinhole, *camera.distortion],
        'is_fisheye': camera.is_fisheye,
    }


def _camera(msg: KeyframePosesMsg) -> CameraModel | None:
    if msg.image_width == 0:
        return None
    with prefixed('keyframe_poses: ', MessageError, ConfigError, ValueError):
        size_px = msg.image_width, msg.image_height
        fx_px, fy_px, cx_px, cy_px, *distortion = msg.camera
        lens = tuple(distortion), msg.is_fisheye
        return CameraModel(*size_px, fx_px, fy_px, cx_px, cy_px, *lens)


def _transforms(rows: FloatArray) -> FloatArray:
    """Return transforms (N, 4, 4) given by three rows each (12 N,); MessageError if not finite."""
    if not np.isfinite(rows).all():
        raise MessageError('a pose has numbers that are not finite')
    T = np.tile(np.eye(4), (len(rows) // _ROWS, 1, 1))
    T[:, :3] = rows.reshape(-1, 3, 4)
    return T
