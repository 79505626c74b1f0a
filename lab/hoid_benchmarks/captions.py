"""Titles and a legend for pictures that `hoid_filter.drawing` makes."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray, ObjectState
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, Bgr

BAR_PX = 26
"""Height of a title and of a row of the legend."""
_TEXT_BGR: Bgr = (255, 255, 255)
_BAR_BGR: Bgr = (50, 50, 50)
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
_LEGEND_MARK_PX, _LEGEND_GAP_PX = 22, 18
_LEGEND = (
    ('feature kept', KEPT_BGR, True),
    ('feature removed', REMOVED_BGR, True),
    ('static object', REASON_BGR[ObjectState.AT_REST], False),
    ('person', REASON_BGR[ObjectState.PERSON], False),
    ('handled object', REASON_BGR[ObjectState.HANDLED], False),
    ('predicted, not detected', REASON_BGR[ObjectState.PREDICTED], False),
    ('handled before', REASON_BGR[ObjectState.REMEMBERED], False),
    ('moves, whatever it is', REASON_BGR[ObjectState.MOVING], False),
)


def draw_legend(picture: ByteArray) -> ByteArray:
    """Return the picture with rows below it that explain the colors."""
    width_px = picture.shape[1]
    bars = [np.full((BAR_PX, width_px, 3), _BAR_BGR, np.uint8)]
    x = _LEGEND_GAP_PX
    for text, color, is_feature in _LEGEND:
        (text_px, _), _ = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
        needed_px = _LEGEND_MARK_PX + text_px + _LEGEND_GAP_PX
        if x > _LEGEND_GAP_PX and x + needed_px > width_px:
            bars.append(np.full((BAR_PX, width_px, 3), _BAR_BGR, np.uint8))
            x = _LEGEND_GAP_PX
        middle = BAR_PX // 2
        if is_feature:
            cv2.circle(bars[-1], (x + 8, middle), 4, color, 1, cv2.LINE_AA)
        else:
            cv2.rectangle(bars[-1], (x, middle - 5), (x + 15, middle + 5), color, 2)
        at = (x + _LEGEND_MARK_PX, BAR_PX - 8)
        cv2.putText(bars[-1], text, at, _FONT, _FONT_SCALE, _TEXT_BGR, 1, cv2.LINE_AA)
        x += needed_px
    return np.vstack([picture, *bars])


def draw_title(picture: ByteArray, text: str) -> ByteArray:
    """Return the picture with a bar above it that shows the text."""
    bar = np.full((BAR_PX, picture.shape[1], 3), _BAR_BGR, np.uint8)
    cv2.putText(bar, text, (8, BAR_PX - 8), _FONT, 0.6, _TEXT_BGR, 1, cv2.LINE_AA)
    return np.vstack([bar, picture])
