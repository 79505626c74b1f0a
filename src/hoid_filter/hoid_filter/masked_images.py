"""The dynamic part of an image as masks, for other SLAM systems, and as points, for planners."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, CameraModel, Float32Array, Reason
from hoid_filter.strategy import Verdict

STATIC, DYNAMIC = 255, 0
_POINT_STRIDE_PX = 8  # 1.5 cm at 1 m in a VGA image, finer than the 5 cm cells of a costmap


class PixelMasks(NamedTuple):
    """The static and the dynamic pixels of an image."""

    static: ByteArray  # (H, W), an OpenCV mask: features may lie where it is not 0
    dynamic: BoolArray  # (H, W), also where `static` was relaxed to keep enough features


def pixel_masks(verdict: Verdict, size_px: tuple[int, int]) -> PixelMasks:
    """Return the masks of an image of size (width, height) from the verdict on it."""
    dynamic = _dynamic_mask(verdict, size_px)
    if verdict.kept is None:  # nothing is dynamic, or too few corners are outside it
        return PixelMasks(np.full(dynamic.shape, STATIC, np.uint8), dynamic)
    return PixelMasks(np.where(dynamic, DYNAMIC, STATIC).astype(np.uint8), dynamic)


def _dynamic_mask(verdict: Verdict, size_px: tuple[int, int]) -> BoolArray:
    if verdict.dynamic_mask is not None:
        low = verdict.dynamic_mask.astype(np.uint8)
        return cv2.resize(low, size_px, interpolation=cv2.INTER_NEAREST) > 0
    mask = np.zeros(size_px[::-1], np.bool_)
    for box, reason in zip(verdict.boxes_xyxy_px, verdict.reasons, strict=True):
        if reason is not Reason.STATIC:
            left, top, right, bottom = np.rint(box).astype(int)
            mask[top:bottom, left:right] = True
    return mask


def static_depth_m(depth_m: Float32Array, mask: ByteArray) -> Float32Array:
    """Return the (H, W) depth, 0 (no reading) on dynamic pixels."""
    return np.where(mask == STATIC, depth_m, np.float32(0))


def points_m(depth_m: Float32Array, mask: BoolArray, camera: CameraModel) -> Float32Array:
    """Return (N, 3) points in the optical frame: every eighth pixel of a mask that has depth.

    Args:
        depth_m: (H, W); 0 or NaN = no reading.
        mask: (H, W).
        camera: Of the same image size.
    """
    step = _POINT_STRIDE_PX
    wanted = mask[::step, ::step] & (depth_m[::step, ::step] > 0)
    v, u = np.nonzero(wanted)
    z = depth_m[::step, ::step][wanted]
    x, y = camera.undistort_px(np.stack([u, v], axis=1).astype(np.float32) * step).T
    points = [(x - camera.cx_px) / camera.fx_px * z, (y - camera.cy_px) / camera.fy_px * z, z]
    return np.stack(points, axis=1).astype(np.float32)
