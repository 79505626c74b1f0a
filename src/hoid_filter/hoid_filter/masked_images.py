"""The full-resolution mask of dynamic pixels, and 3-D points of masked depth for planners."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import BoolArray, CameraModel, Float32Array, ObjectState
from hoid_filter.strategy import Verdict

_POINT_STRIDE_PX = 8  # 1.5 cm at 1 m in a VGA image, finer than the 5 cm cells of a costmap


def dynamic_mask(verdict: Verdict, size_px: tuple[int, int]) -> BoolArray:
    """Return the mask (H, W) of dynamic pixels; if there is none, the boxes of dynamic objects."""
    if verdict.dynamic_mask is not None:
        low = verdict.dynamic_mask.astype(np.uint8)
        return cv2.resize(low, size_px, interpolation=cv2.INTER_NEAREST) > 0
    mask = np.zeros(size_px[::-1], np.bool_)
    objects = verdict.objects
    for box, reason in zip(objects.boxes_xyxy_px, objects.reasons, strict=True):
        if reason is not ObjectState.AT_REST:
            left, top, right, bottom = np.rint(box).astype(int)
            mask[top:bottom, left:right] = True
    return mask


def points_m(depth_m: Float32Array, mask: BoolArray, camera: CameraModel) -> Float32Array:
    """Return optical-frame points (N, 3) of masked pixels (H, W), every eighth in x and y."""
    step = _POINT_STRIDE_PX
    wanted = mask[::step, ::step] & (depth_m[::step, ::step] > 0)
    v, u = np.nonzero(wanted)
    z = depth_m[::step, ::step][wanted]
    x, y = camera.undistort_px(np.stack([u, v], axis=1).astype(np.float32) * step).T
    points = [(x - camera.cx_px) / camera.fx_px * z, (y - camera.cy_px) / camera.fy_px * z, z]
    return np.stack(points, axis=1).astype(np.float32)
