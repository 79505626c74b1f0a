"""What the filter accepts from a detector, and what it refuses or clips."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import Detections
from hoid_filter.overlap import areas_px2, clip_boxes


class Sanitized(NamedTuple):
    """Detections fit for use, and how many were not."""

    detections: Detections
    num_refused: int  # not a number, inverted, without area inside the image, or too many
    num_clipped: int  # partly outside the image, or a score outside [0, 1]


def sanitize(
    detections: Detections, width_px: int, height_px: int, max_detections: int
) -> Sanitized:
    """Return the detections with boxes inside the image and scores in [0, 1].

    Refused: boxes or scores that are not numbers, inverted boxes, boxes without area inside the
    image, and all but the `max_detections` best. Boxes that reach beyond the image and scores
    beyond [0, 1] are clipped.
    """
    if len(detections) <= max_detections and _is_fit(detections, width_px, height_px):
        return Sanitized(detections, 0, 0)
    raw, scores = detections.boxes_xyxy_px, detections.scores
    boxes = clip_boxes(raw, width_px, height_px).astype(np.float32)
    clipped = (boxes != raw).any(axis=1) | (scores < 0) | (scores > 1)
    usable = np.isfinite(raw).all(axis=1) & np.isfinite(scores) & (areas_px2(boxes) > 0)
    usable &= (raw[:, 2:] > raw[:, :2]).all(axis=1)
    kept = np.flatnonzero(usable)
    if len(kept) > max_detections:
        best = np.argsort(-scores[kept], kind='stable')[:max_detections]
        kept = np.sort(kept[best])
    names = detections.class_names
    fit = Detections(
        detections.stamp_ns,
        boxes[kept],
        tuple(names[k] for k in kept.tolist()),
        np.clip(scores[kept], 0.0, 1.0),
    )
    return Sanitized(fit, len(detections) - len(kept), int(np.count_nonzero(clipped[kept])))


def _is_fit(detections: Detections, width_px: int, height_px: int) -> bool:
    """Return whether nothing is to be mended; NaN fails every comparison."""
    scores = detections.scores.tolist()
    for (x1, y1, x2, y2), score in zip(detections.boxes_xyxy_px.tolist(), scores, strict=True):
        inside = 0 <= x1 < x2 <= width_px and 0 <= y1 < y2 <= height_px
        if not (inside and 0 <= score <= 1):
            return False
    return True
