"""Prediction of detected boxes to the stamp of an image without detections."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Detections, IntArray
from hoid_native import intersections_over_union

_MIN_IOU = 0.2  # chosen: least overlap of the boxes of one object in two successive detections


class BoxPredictor:
    """Predicts boxes at constant velocity from the last two `Detections`, by up to `limit_s`."""

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._last: Detections | None = None
        self._previous: Detections | None = None

    def observe(self, detections: Detections) -> None:
        if self._last is None or detections.stamp_ns > self._last.stamp_ns:
            self._previous, self._last = self._last, detections

    def predict(self, stamp_ns: int) -> Detections:
        """Return the boxes predicted for a stamp, which may be partly outside the image.

        They are empty if the stamp is more than `limit_s` from the last detections.
        """
        if self._last is None or abs(stamp_ns - self._last.stamp_ns) > self.limit_s * 1e9:
            return Detections.none(stamp_ns)
        last = self._last
        boxes = last.boxes_xyxy_px.astype(np.float64)
        if self._previous is not None:
            i, k = match_boxes(last, self._previous, _MIN_IOU)
            span_ns = last.stamp_ns - self._previous.stamp_ns
            step = (stamp_ns - last.stamp_ns) / span_ns
            boxes[i] += step * (boxes[i] - self._previous.boxes_xyxy_px[k])
        boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2])
        return Detections(stamp_ns, boxes.astype(np.float32), last.class_names, last.scores)


def match_boxes(
    detections: Detections, others: Detections, min_iou: float
) -> tuple[IntArray, IntArray]:
    """Return the indices (K,) in each set of matched boxes: same class, greedily by overlap."""
    iou = intersections_over_union(detections.boxes_xyxy_px, others.boxes_xyxy_px)
    same = np.array(detections.class_names)[:, None] == np.array(others.class_names)[None]
    return match_greedily(np.where(same, iou, 0.0), min_iou)


def match_greedily(score: np.ndarray, minimum: float) -> tuple[IntArray, IntArray]:
    """Return rows (K,) and columns (K,) of one-to-one pairs by score (N, M), the best first."""
    rows, columns = np.nonzero(score >= minimum)
    order = np.argsort(-score[rows, columns], kind='stable')
    free_row, free_column = set(rows.tolist()), set(columns.tolist())
    pairs = []
    for i, k in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if i in free_row and k in free_column:
            free_row.remove(i)
            free_column.remove(k)
            pairs.append((i, k))
    found = np.array(pairs, np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]
