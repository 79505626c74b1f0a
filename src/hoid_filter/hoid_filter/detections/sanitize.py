"""Validation of detections: unusable boxes are dropped, the others are clipped to the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import Detections, Float32Array, FloatArray

Boxes = Float32Array | FloatArray


class Sanitized(NamedTuple):
    """Valid detections, and the numbers of boxes that were dropped or clipped."""

    detections: Detections
    num_refused: int  # dropped: not finite, inverted, without area inside the image, or too many
    num_clipped: int  # clipped: partly outside the image, or a score outside [0, 1]


def sanitize(
    detections: Detections, width_px: int, height_px: int, max_detections: int
) -> Sanitized:
    """Return the usable detections, with boxes clipped to the image and scores to [0, 1].

    Boxes that are not finite, inverted or without area in the image are dropped, and so are scores
    that are not finite. At most `max_detections` boxes remain: those with the highest scores.
    """
    raw, scores = detections.boxes_xyxy_px, detections.scores
    if len(raw) <= max_detections and _are_valid(raw, scores, width_px, height_px):
        return Sanitized(detections, 0, 0)
    boxes = clip_boxes(raw, width_px, height_px).astype(np.float32)
    clipped = (boxes != raw).any(axis=1) | (scores < 0) | (scores > 1)
    usable = np.isfinite(raw).all(axis=1) & np.isfinite(scores) & (areas_px2(boxes) > 0)
    usable &= (raw[:, 2:] > raw[:, :2]).all(axis=1)
    kept = np.flatnonzero(usable)
    if len(kept) > max_detections:
        best = np.argsort(-scores[kept], kind='stable')[:max_detections]
        kept = np.sort(kept[best])
    names = detections.class_names
    valid = Detections(
        detections.stamp_ns,
        boxes[kept],
        tuple(names[k] for k in kept.tolist()),
        np.clip(scores[kept], 0.0, 1.0),
    )
    return Sanitized(valid, len(detections) - len(kept), int(np.count_nonzero(clipped[kept])))


def _are_valid(boxes: Float32Array, scores: Float32Array, width_px: int, height_px: int) -> bool:
    low, high = boxes[:, :2], boxes[:, 2:]
    is_box_valid = (low >= 0) & (low < high) & (high <= (width_px, height_px))  # False for NaN
    return bool(is_box_valid.all() and ((scores >= 0) & (scores <= 1)).all())


def clip_boxes(boxes_xyxy_px: Boxes, width_px: int, height_px: int) -> FloatArray:
    """Return the boxes (N, 4) clipped to the image; a box outside it gets an area of 0."""
    limits = np.array([width_px, height_px, width_px, height_px], np.float64)
    inside: FloatArray = np.minimum(np.maximum(boxes_xyxy_px.astype(np.float64), 0.0), limits)
    return inside


def areas_px2(boxes_xyxy_px: Boxes) -> FloatArray:
    """Return the areas (N,) of boxes (N, 4); 0 where x2 < x1 or y2 < y1."""
    sides = np.maximum(boxes_xyxy_px[:, 2:].astype(np.float64) - boxes_xyxy_px[:, :2], 0.0)
    area: FloatArray = sides[:, 0] * sides[:, 1]
    return area
