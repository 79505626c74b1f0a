"""Depth at a quarter of the image's size, which is enough where what matters is large."""

from __future__ import annotations

import functools

import numpy as np

from hoid_common.values import Float32Array, FloatArray, IntArray
from hoid_filter.extraction.pyramid import Int32Array

SHRINK = 4


def shrink(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row."""
    return np.ascontiguousarray(depth_m[SHRINK // 2 :: SHRINK, SHRINK // 2 :: SHRINK])


@functools.cache
def small_pixels(shape_hw: tuple[int, ...]) -> IntArray:
    """Return the flat indices in an (H, W) image, (h, w), of the pixels that `shrink` takes."""
    flat = np.arange(shape_hw[0] * shape_hw[1]).reshape(shape_hw)
    return flat[SHRINK // 2 :: SHRINK, SHRINK // 2 :: SHRINK]


def cells(boxes_xyxy_px: FloatArray, shape_hw: tuple[int, ...]) -> Int32Array:
    """Return the pixels (N, 4), as boxes, of a small image that boxes of the full one cover."""
    height, width = shape_hw
    small = boxes_xyxy_px / SHRINK
    small[:, :2] = np.floor(small[:, :2])
    small[:, 2:] = np.minimum(np.ceil(small[:, 2:]), (width, height))
    return np.maximum(small, 0).astype(np.int32)
