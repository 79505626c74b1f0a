"""Drawing of detections."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import PERSON, ByteArray, Detections

_PERSON_BGR = (60, 60, 230)
_OBJECT_BGR = (60, 190, 60)
_TEXT_BGR = (255, 255, 255)


def draw_detections(image_bgr: ByteArray, detections: Detections) -> ByteArray:
    """Return a copy of the image (H, W, 3) with labeled boxes: people red, all others green."""
    picture = image_bgr.copy()
    for box, name, score in zip(
        np.rint(detections.boxes_xyxy_px).astype(int).tolist(),
        detections.class_names,
        detections.scores.tolist(),
        strict=True,
    ):
        color = _PERSON_BGR if name == PERSON else _OBJECT_BGR
        x1, y1, x2, y2 = box
        cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), color, 2)
        text = f'{name} {score:.2f}'
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        top = max(y1, height + 4)  # keeps the label below the top edge
        cv2.rectangle(picture, (x1, top - height - 4), (x1 + width + 2, top), color, cv2.FILLED)
        cv2.putText(picture, text, (x1 + 1, top - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _TEXT_BGR, 1)
    return picture
