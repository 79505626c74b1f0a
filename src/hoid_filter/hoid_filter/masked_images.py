"""What moves as pixels, for a SLAM that finds its features itself, and as points for planners."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, CameraModel, Float32Array, Reason
from hoid_filter.detections.aligned_detections import Verdict

STATIC, MOVING = 255, 0
_POINT_STRIDE_PX = 8  # 1.5 cm at 1 m in a picture 640 px wide, finer than cells of a costmap


class PixelMasks(NamedTuple):
    """Which pixels of an image move."""

    static: ByteArray  # (H, W), in OpenCV's sense: features may lie where it is not 0
    moving: BoolArray  # (H, W), however little else that leaves


def pixel_masks(verdict: Verdict, size_px: tuple[int, int]) -> PixelMasks:
    """Return the masks of an image of a width and height, by the verdict on it."""
    moving = _moving_mask(verdict, size_px)
    if verdict.kept is None:  # nothing moves, or too little else is left
        return PixelMasks(np.full(moving.shape, STATIC, np.uint8), moving)
    return PixelMasks(np.where(moving, MOVING, STATIC).astype(np.uint8), moving)


def _moving_mask(verdict: Verdict, size_px: tuple[int, int]) -> BoolArray:
    if verdict.moves is not None:
        moves = verdict.moves.astype(np.uint8)
        return cv2.resize(moves, size_px, interpolation=cv2.INTER_NEAREST) > 0
    mask = np.zeros(size_px[::-1], np.bool_)
    for box, reason in zip(verdict.boxes_xyxy_px, verdict.reasons, strict=True):
        if reason is not Reason.STATIC:
            left, top, right, bottom = np.rint(box).astype(int)
            mask[top:bottom, left:right] = True
    return mask


def static_depth_m(depth_m: Float32Array, mask: ByteArray) -> Float32Array:
    """Return (H, W) depth without that of what moves, where it is 0: no reading."""
    return np.where(mask == STATIC, depth_m, np.float32(0))


def points_m(depth_m: Float32Array, mask: BoolArray, camera: CameraModel) -> Float32Array:
    """Return (N, 3) points in the optical frame: every few pixels' of the mask that have depth.

    Args:
        depth_m: (H, W); 0 or NaN = no reading.
        mask: (H, W).
        camera: Of the same size.
    """
    step = _POINT_STRIDE_PX
    wanted = mask[::step, ::step] & (depth_m[::step, ::step] > 0)
    v, u = np.nonzero(wanted)
    z = depth_m[::step, ::step][wanted]
    x, y = camera.undistort_px(np.stack([u, v], axis=1).astype(np.float32) * step).T
    points = [(x - camera.cx_px) / camera.fx_px * z, (y - camera.cy_px) / camera.fy_px * z, z]
    return np.stack(points, axis=1).astype(np.float32)
