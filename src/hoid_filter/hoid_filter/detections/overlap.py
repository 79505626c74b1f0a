"""Clipping and areas of boxes."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array, FloatArray

Boxes = Float32Array | FloatArray


def clip_boxes(boxes_xyxy_px: Boxes, width_px: int, height_px: int) -> FloatArray:
    """Return the boxes (N, 4) clipped to the image, with an area of 0 outside of it."""
    limits = np.array([width_px, height_px, width_px, height_px], np.float64)
    inside: FloatArray = np.minimum(np.maximum(boxes_xyxy_px.astype(np.float64), 0.0), limits)
    return inside


def areas_px2(boxes_xyxy_px: Boxes) -> FloatArray:
    """Return the areas (N,) of boxes (N, 4); 0 where x2 < x1 or y2 < y1."""
    sides = np.maximum(boxes_xyxy_px[:, 2:].astype(np.float64) - boxes_xyxy_px[:, :2], 0.0)
    area: FloatArray = sides[:, 0] * sides[:, 1]
    return area
