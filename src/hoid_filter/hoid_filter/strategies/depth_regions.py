"""Depth images at a quarter of the resolution, at which dynamic objects are masked."""

from __future__ import annotations

import functools

import numpy as np

from hoid_common.values import Float32Array, FloatArray, IntArray
from hoid_filter.extraction.pyramid import Int32Array

STRIDE_PX = 4  # chosen: 160x120 of VGA, at which a mask takes a sixteenth of the time


def subsample(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row of depth (H, W), from row and column 2 on."""
    half = STRIDE_PX // 2
    return np.ascontiguousarray(depth_m[half::STRIDE_PX, half::STRIDE_PX])


@functools.cache
def subsampled_pixels(shape_hw: tuple[int, ...]) -> IntArray:
    """Return the (h, w) flat indices, in an (H, W) image, of the pixels that `subsample` takes."""
    flat = np.arange(shape_hw[0] * shape_hw[1]).reshape(shape_hw)
    half = STRIDE_PX // 2
    return flat[half::STRIDE_PX, half::STRIDE_PX]


def subsampled_boxes(boxes_xyxy_px: FloatArray, shape_hw: tuple[int, ...]) -> Int32Array:
    """Return the (N, 4) smallest low-resolution boxes that cover given ones, clipped."""
    height, width = shape_hw
    covering = boxes_xyxy_px / STRIDE_PX
    covering[:, :2] = np.floor(covering[:, :2])
    covering[:, 2:] = np.minimum(np.ceil(covering[:, 2:]), (width, height))
    return np.maximum(covering, 0).astype(np.int32)
