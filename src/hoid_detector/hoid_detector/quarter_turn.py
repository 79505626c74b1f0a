"""Turns images of a camera that is mounted rotated upright for the network, and boxes back.

Networks are trained on upright people. Upside down, YOLOv8n finds little more than half of them.
"""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray

_QUARTER_DEG = 90
_MIN_UP = 0.5  # chosen: a camera pitched by more than 60 degrees has no upright images
_CODES = (None, cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_180, cv2.ROTATE_90_COUNTERCLOCKWISE)


def mounted_roll_deg(T_base_camera: FloatArray) -> float:
    """Return the roll (deg) of a camera in a base frame with z up, clockwise seen from behind.

    It is 0 for a camera that looks more than 60 degrees up or down.
    """
    right, down = T_base_camera[2, :2]  # upward components of the image's x and y axes
    if np.hypot(right, down) < _MIN_UP:
        return 0.0
    return float(np.rad2deg(np.arctan2(-right, -down)))


def nearest_quarter(camera_roll_deg: float) -> int:
    """Return the number of clockwise quarter turns, 0 to 3, that make the images upright."""
    return round(camera_roll_deg / _QUARTER_DEG) % len(_CODES)


def turned(image_bgr: ByteArray, quarters: int) -> ByteArray:
    code = _CODES[quarters]
    return image_bgr if code is None else cv2.rotate(image_bgr, code).astype(np.uint8, copy=False)


def boxes_before_turn(
    boxes_xyxy_px: Float32Array, quarters: int, size_wh: tuple[int, int]
) -> Float32Array:
    """Return boxes (N, 4) of a turned image in the original image of `size_wh` (width, height)."""
    width, height = size_wh
    x1, y1, x2, y2 = boxes_xyxy_px.T
    before = (
        (x1, y1, x2, y2),
        (y1, height - x2, y2, height - x1),
        (width - x2, height - y2, width - x1, height - y1),
        (width - y2, x1, width - y1, x2),
    )
    return np.stack(before[quarters], axis=1).astype(np.float32)
