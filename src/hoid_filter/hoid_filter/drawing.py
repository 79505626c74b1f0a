"""Drawing of features, and of the boxes of static and dynamic objects, on an image."""

from __future__ import annotations

import math

import cv2
import numpy as np

from hoid_common.values import ByteArray, DynamicObject, FilterResult, Float32Array, ObjectState

Bgr = tuple[int, int, int]

KEPT_BGR: Bgr = (80, 220, 60)
REMOVED_BGR: Bgr = (60, 60, 240)
REASON_BGR: dict[ObjectState, Bgr] = {
    ObjectState.AT_REST: (60, 190, 60),
    ObjectState.PERSON: (60, 60, 230),
    ObjectState.HANDLED: (0, 140, 255),
    ObjectState.PREDICTED: (220, 60, 220),
    ObjectState.REMEMBERED: (230, 200, 40),
    ObjectState.MOVING: (0, 230, 230),
}
_TEXT_BGR: Bgr = (255, 255, 255)
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
_RADIUS_PX = 2


def draw_result(image_bgr: ByteArray, result: FilterResult) -> ByteArray:
    """Return a copy of the image (H, W, 3) with features and boxes, colored by state."""
    picture = image_bgr.copy()
    draw_points(picture, result.removed_uv_px, REMOVED_BGR)
    draw_points(picture, result.features.uv_px, KEPT_BGR)
    for item in result.objects:
        x1, y1, x2, y2 = (round(value) for value in item.box_xyxy_px)
        cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), REASON_BGR[item.state], 2)
    for item in result.objects:  # after all boxes, so that no box edge crosses a label
        _draw_label(picture, item)
    return picture


def draw_points(picture: ByteArray, uv_px: Float32Array, color: Bgr) -> None:
    for center in np.rint(uv_px).astype(int).tolist():
        cv2.circle(picture, center, _RADIUS_PX, color, 1, cv2.LINE_AA)


def _draw_label(picture: ByteArray, item: DynamicObject) -> None:
    color, text = REASON_BGR[item.state], label(item)
    x1, y1 = (round(value) for value in item.box_xyxy_px[:2])
    (width, height), _ = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    top = max(y1, height + 4)  # keeps the label inside the picture
    cv2.rectangle(picture, (x1, top - height - 4), (x1 + width + 2, top), color, cv2.FILLED)
    cv2.putText(picture, text, (x1 + 1, top - 3), _FONT, _FONT_SCALE, _TEXT_BGR, 1, cv2.LINE_AA)


def label(item: DynamicObject) -> str:
    """Return class, score, and the overlap and depth gap to a person, for a picture."""
    text = f'{item.class_name} {item.score:.2f}'
    if item.overlap_ratio > 0:
        text += f' {item.overlap_ratio:.0%}'
        if not math.isnan(item.depth_gap_m):
            text += f' {item.depth_gap_m:.2f} m'
    return text
