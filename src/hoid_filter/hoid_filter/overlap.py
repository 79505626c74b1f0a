"""Areas that boxes share: the measure of interaction in the HOID rules."""

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
    x1, y1, x2, y2 = boxes_xyxy_px.T.astype(np.float64)[:, :, None]
    u1, v1, u2, v2 = others_xyxy_px.T.astype(np.float64)
    width = np.maximum(np.minimum(x2, u2) - np.maximum(x1, u1), 0.0)
    height = np.maximum(np.minimum(y2, v2) - np.maximum(y1, v1), 0.0)
    area: FloatArray = width * height
    return area


def overlap_ratios(objects_xyxy_px: Boxes, people_xyxy_px: Boxes) -> FloatArray:
    """Return the (N, M) shares of each object's own area that lie in each person's box.

    In [0, 1]; 0 for an object without area. This is the interaction area of the HOID paper.
    """
    own = areas_px2(objects_xyxy_px)[:, None]
    shared = shared_areas_px2(objects_xyxy_px, people_xyxy_px)
    return np.divide(shared, own, out=np.zeros_like(shared), where=own > 0)


def intersections_over_union(boxes_xyxy_px: Boxes, others_xyxy_px: Boxes) -> FloatArray:
    """Return the (N, M) ratios in [0, 1] of shared area to joint area."""
    shared = shared_areas_px2(boxes_xyxy_px, others_xyxy_px)
    union = areas_px2(boxes_xyxy_px)[:, None] + areas_px2(others_xyxy_px)[None] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
