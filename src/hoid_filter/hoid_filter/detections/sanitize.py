"""What the filter accepts from a detector, and what it refuses or clips."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import Detections
from hoid_filter.detections.overlap import areas_px2, clip_boxes
from hoid_native import are_boxes_fit


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
    raw, scores = detections.boxes_xyxy_px, detections.scores
    if len(raw) <= max_detections and are_boxes_fit(raw, scores, (height_px, width_px)):
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
    fit = Detections(
        detections.stamp_ns,
        boxes[kept],
        tuple(names[k] for k in kept.tolist()),
        np.clip(scores[kept], 0.0, 1.0),
    )
    return Sanitized(fit, len(detections) - len(kept), int(np.count_nonzero(clipped[kept])))
