"""Boxes of objects of a map in images."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import ByteArray, CameraModel, Float32Array, FloatArray, ObjectState
from hoid_scene.objects.mapped_object import MapObject

_STEPS = 12  # points of a box along each axis, which are projected
_NEAR_M = 0.05  # points nearer to the camera are not projected
_BORDER_SHARE = 0.2  # points farther outside the image are not distorted, but left out
_FONT, _TEXT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45


def _edges() -> FloatArray:
    """Return points (N, 3) on the edges of a box, from -0.5 to 0.5 along each axis."""
    along = np.linspace(-0.5, 0.5, 80)
    parts = []
    for axis, ends in product(range(3), product((-0.5, 0.5), repeat=2)):
        points = np.insert(np.tile(ends, (len(along), 1)), axis, along, axis=1)
        parts.append(points)
    return np.concatenate(parts)


_EDGES = _edges()


def box_in_image(item: MapObject, T_map_camera: FloatArray, camera: CameraModel) -> Float32Array:
    """Return the box (4,) px around what an image shows of an object's box; zeros for nothing."""
    steps = np.linspace(-0.5, 0.5, _STEPS)
    inside = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    uv = visible_px(item, inside, T_map_camera, camera)
    corners = (uv.min(axis=0), uv.max(axis=0)) if len(uv) else (np.zeros(4),)
    return np.concatenate(corners).astype(np.float32)


def visible_px(
    item: MapObject, inside: FloatArray, T_map_camera: FloatArray, camera: CameraModel
) -> FloatArray:
    """Return the pixels (M, 2) of those points of an object's box that are in an image.

    Args:
        item: The object.
        inside: (N, 3) points, from -0.5 to 0.5 along each axis of the box.
        T_map_camera: (4, 4) pose of the image.
        camera: Camera of the image.
    """
    T_camera_object = se3.inverse(T_map_camera) @ item.T_map_object
    points_m = se3.transform(T_camera_object, inside * item.size_m)
    points_m = points_m[points_m[:, 2] > _NEAR_M]
    size_px = np.array([camera.width_px, camera.height_px])
    focal_px, center_px = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    straight_px = points_m[:, :2] / points_m[:, 2:] * focal_px + center_px
    border_px = _BORDER_SHARE * size_px
    is_near = ((straight_px > -border_px) & (straight_px < size_px + border_px)).all(axis=1)
    uv = camera.project_px(points_m[is_near])
    return np.asarray(uv[((uv >= 0) & (uv < size_px)).all(axis=1)])


def draw_box(
    picture: ByteArray,
    item: MapObject,
    T_map_camera: FloatArray,
    camera: CameraModel,
    color: tuple[int, int, int],
) -> None:
    """Draw the edges of an object's box, with number, class and state, into an image."""
    for point in visible_px(item, _EDGES, T_map_camera, camera).astype(int).tolist():
        cv2.circle(picture, point, 1, color, -1)
    box_px = box_in_image(item, T_map_camera, camera)
    if box_px.any():
        state = '' if item.state is ObjectState.AT_REST else f' {item.state.name.lower()}'
        text = f'{item.object_id} {item.class_name}{state}'
        write_text(picture, text, (int(box_px[0]) + 2, max(int(box_px[1]), 12) + 12), color)


def write_text(
    picture: ByteArray, text: str, at: tuple[int, int], color: tuple[int, int, int]
) -> None:
    """Write a text with a dark rim."""
    for rim, thickness in (((0, 0, 0), 3), (color, 1)):
        cv2.putText(picture, text, at, _FONT, _TEXT_SCALE, rim, thickness, cv2.LINE_AA)
