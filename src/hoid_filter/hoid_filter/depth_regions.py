"""Depth at a quarter of the image's size, which is enough where what matters is large."""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import Float32Array

SHRINK = 4

Box = tuple[float, float, float, float]
Cells = tuple[int, int, int, int]
Area = tuple[slice, slice]


def shrink(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row."""
    return np.ascontiguousarray(depth_m[SHRINK // 2 :: SHRINK, SHRINK // 2 :: SHRINK])


def cells(box_xyxy_px: Box, shape_hw: tuple[int, ...]) -> Cells:
    """Return the pixels (x1, y1, x2, y2) of a small image that a box of the full image covers."""
    height, width = shape_hw
    x1, y1, x2, y2 = (value / SHRINK for value in box_xyxy_px)
    return (
        max(math.floor(x1), 0),
        max(math.floor(y1), 0),
        min(max(math.ceil(x2), 0), width),
        min(max(math.ceil(y2), 0), height),
    )


def crop(box_xyxy_px: Box, shape_hw: tuple[int, ...]) -> Area:
    """Return the same as rows and columns."""
    x1, y1, x2, y2 = cells(box_xyxy_px, shape_hw)
    return slice(y1, y2), slice(x1, x2)
