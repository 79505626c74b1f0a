"""The names of colors, as people use them to distinguish things."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray, IntArray

COLORS = (
    'black', 'gray', 'white', 'red', 'orange', 'yellow', 'green', 'blue', 'purple', 'pink',
    'brown',
)  # fmt: skip
"""The basic colors of English (Berlin and Kay, 1969)."""
# Chosen, on OpenCV's scales (hue to 180, saturation and value to 255). A pixel is black below the
# first value, and below this saturation gray, or white from the second value on. Other pixels are
# named by hue: from each limit on, the name after it. Orange and yellow are brown if dark, red and
# purple are pink if pale.
_BLACK, _WHITE, _PALE = 50, 150, 55
_HUES = (
    (0, 'red'), (9, 'orange'), (22, 'yellow'), (35, 'green'), (88, 'blue'), (128, 'purple'),
    (150, 'pink'), (170, 'red'),
)  # fmt: skip
_BROWN, _PINK_SATURATION, _PINK_VALUE = 140, 120, 150
# Chosen: the colors of an object are those that each have at least this ratio of its pixels.
_NAMED_RATIO = 0.25


def color_counts(pixels_bgr: ByteArray) -> IntArray:
    """Return how many of the pixels (N, 3) have each of the `COLORS`, (11,)."""
    if len(pixels_bgr) == 0:
        return np.zeros(len(COLORS), np.int64)
    hsv = cv2.cvtColor(np.ascontiguousarray(pixels_bgr[:, None]), cv2.COLOR_BGR2HSV)[:, 0]
    hue, saturation, value = hsv.T
    limits = np.array([low for low, _ in _HUES])
    names = np.array([COLORS.index(name) for _, name in _HUES])
    found = names[np.searchsorted(limits, hue, 'right') - 1]
    is_warm = (found == COLORS.index('orange')) | (found == COLORS.index('yellow'))
    found[is_warm & (value < _BROWN)] = COLORS.index('brown')
    is_reddish = (found == COLORS.index('red')) | (found == COLORS.index('purple'))
    is_soft = (saturation < _PINK_SATURATION) & (value >= _PINK_VALUE)
    found[is_reddish & is_soft] = COLORS.index('pink')
    is_pale = saturation < _PALE
    found[is_pale] = COLORS.index('gray')
    found[is_pale & (value >= _WHITE)] = COLORS.index('white')
    found[value < _BLACK] = COLORS.index('black')
    return np.bincount(found, minlength=len(COLORS))


def color_names(counts: IntArray) -> tuple[str, ...]:
    """Return the colors that have at least a quarter of the counted pixels (11,).

    The most frequent color is first. If no color has a quarter, only that one is returned.
    """
    total = int(counts.sum())
    if total == 0:
        return ()
    order = np.argsort(-counts, kind='stable')
    shares = counts[order] / total
    num = max(1, int(np.count_nonzero(shares >= _NAMED_RATIO)))
    return tuple(COLORS[i] for i in order[:num].tolist())
