"""Non-maximum suppression within each class."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import Float32Array, IntArray

MAX_CANDIDATES = 1000  # chosen: more boxes reach the threshold only if it is near zero


def nms(
    boxes_xyxy_px: Float32Array, scores: Float32Array, class_ids: IntArray, iou: float
) -> IntArray:
    """Return the indices of the boxes (N, 4) that are kept, highest score first."""
    order = np.argsort(-scores, kind='stable')[:MAX_CANDIDATES]
    if len(order) < 2:
        return order
    boxes_xywh_px = boxes_xyxy_px[order]
    boxes_xywh_px[:, 2:] -= boxes_xywh_px[:, :2]
    kept = cv2.dnn.NMSBoxesBatched(
        boxes_xywh_px.tolist(), scores[order].tolist(), class_ids[order].tolist(), -1.0, iou
    )
    return order[np.sort(np.asarray(kept, np.int64).ravel())]
