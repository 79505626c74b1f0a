"""Boxes, their areas, and what they share."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array, FloatArray

Boxes = Float32Array | FloatArray


def clip_boxes(boxes_xyxy_px: Boxes, width_px: int, height_px: int) -> FloatArray:
    """Return the (N, 4) parts of the boxes inside the image; outside ones become empty."""
    limits = np.array([width_px, height_px, width_px, height_px], np.float64)
    inside: FloatArray = np.minimum(np.maximum(boxes_xyxy_px.astype(np.float64), 0.0), limits)
    return inside


def areas_px2(boxes_xyxy_px: Boxes) -> FloatArray:
    """Return the (N,) areas; an inverted box has none."""
    sides = np.maximum(boxes_xyxy_px[:, 2:].astype(np.float64) - boxes_xyxy_px[:, :2], 0.0)
    area: FloatArray = sides[:, 0] * sides[:, 1]
    return area


def shared_areas_px2(boxes_xyxy_px: Boxes, others_xyxy_px: Boxes) -> FloatArray:
    """Return the (N, M) areas that each of N boxes shares with each of M others."""
    boxes, others = boxes_xyxy_px.astype(np.float64), others_xyxy_px.astype(np.float64)
    sides = np.minimum(boxes[:, None, 2:], others[:, 2:])
    sides -= np.maximum(boxes[:, None, :2], others[:, :2])
    np.maximum(sides, 0.0, out=sides)
    area: FloatArray = sides[..., 0] * sides[..., 1]
    return area


def intersections_over_union(boxes_xyxy_px: Boxes, others_xyxy_px: Boxes) -> FloatArray:
    """Return the (N, M) ratios in [0, 1] of shared area to joint area."""
    shared = shared_areas_px2(boxes_xyxy_px, others_xyxy_px)
    union = areas_px2(boxes_xyxy_px)[:, None] + areas_px2(others_xyxy_px)[None] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
