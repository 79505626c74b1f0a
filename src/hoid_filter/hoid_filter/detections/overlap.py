"""Clipping and areas of boxes."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array, FloatArray

Boxes = Float32Array | FloatArray


def clip_boxes(boxes_xyxy_px: Boxes, width_px: int, height_px: int) -> FloatArray:
    """Return the (N, 4) boxes clipped to the image; a box outside the image gets an area of 0."""
    limits = np.array([width_px, height_px, width_px, height_px], np.float64)
    inside: FloatArray = np.minimum(np.maximum(boxes_xyxy_px.astype(np.float64), 0.0), limits)
    return inside


def areas_px2(boxes_xyxy_px: Boxes) -> FloatArray:
    """Return the (N,) areas of (N, 4) boxes x1, y1, x2, y2; 0 where x2 < x1 or y2 < y1."""
    sides = np.maximum(boxes_xyxy_px[:, 2:].astype(np.float64) - boxes_xyxy_px[:, :2], 0.0)
    area: FloatArray = sides[:, 0] * sides[:, 1]
    return area
