"""What moves as pixels, for a SLAM that finds its features itself."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray, Float32Array, Reason
from hoid_filter.detections.aligned_detections import Verdict

STATIC, MOVING = 255, 0


def static_mask(verdict: Verdict, size_px: tuple[int, int]) -> ByteArray:
    """Return an (H, W) mask, in OpenCV's sense: features may lie where it is not 0.

    Args:
        verdict: On the image.
        size_px: Width and height of the image.
    """
    width, height = size_px
    mask = np.full((height, width), STATIC, np.uint8)
    if verdict.kept is None:  # nothing moves, or too little else is left
        return mask
    if verdict.moves is not None:
        moves = verdict.moves.astype(np.uint8)
        mask[cv2.resize(moves, size_px, interpolation=cv2.INTER_NEAREST) > 0] = MOVING
        return mask
    for box, reason in zip(verdict.boxes_xyxy_px, verdict.reasons, strict=True):
        if reason is not Reason.STATIC:
            left, top, right, bottom = np.rint(box).astype(int)
            mask[top:bottom, left:right] = MOVING
    return mask


def static_depth_m(depth_m: Float32Array, mask: ByteArray) -> Float32Array:
    """Return (H, W) depth without that of what moves, where it is 0: no reading."""
    return np.where(mask == STATIC, depth_m, np.float32(0))
