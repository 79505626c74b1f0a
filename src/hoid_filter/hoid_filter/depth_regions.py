"""Depth at a quarter of the image's size, which is enough where what matters is large."""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import Float32Array, FloatArray
from hoid_filter.pyramid import Int32Array

SHRINK = 4

Box = tuple[float, float, float, float]
Area = tuple[slice, slice]


def shrink(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row."""
    return np.ascontiguousarray(depth_m[SHRINK // 2 :: SHRINK, SHRINK // 2 :: SHRINK])


def cells(boxes_xyxy_px: FloatArray, shape_hw: tuple[int, ...]) -> Int32Array:
    """Return the pixels (N, 4), as boxes, of a small image that boxes of the full one cover."""
    height, width = shape_hw
    small = boxes_xyxy_px / SHRINK
    small[:, :2] = np.floor(small[:, :2])
    small[:, 2:] = np.minimum(np.ceil(small[:, 2:]), (width, height))
    return np.maximum(small, 0).astype(np.int32)


def crop(box_xyxy_px: Box, shape_hw: tuple[int, ...]) -> Area:
    """Return the same for one box, as rows and columns."""
    height, width = shape_hw
    x1, y1, x2, y2 = box_xyxy_px
    return (
        slice(max(math.floor(y1 / SHRINK), 0), min(max(math.ceil(y2 / SHRINK), 0), height)),
        slice(max(math.floor(x1 / SHRINK), 0), min(max(math.ceil(x2 / SHRINK), 0), width)),
    )
