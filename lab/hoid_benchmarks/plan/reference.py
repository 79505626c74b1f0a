"""A piece of work that never changes, as the unit of cost on this machine."""

from __future__ import annotations

import time

import cv2
import numpy as np

_REPEATS = 15


def reference_ms() -> float:
    """Return the thread CPU time in ms of OpenCV's own ORB (1000 features) on a fixed picture.

    Costs as multiples of it can be compared across machines, where times cannot; the median of
    several calls, in the process whose cost is in question.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    picture, orb = _picture(), cv2.ORB.create(1000)
    spent_ms = []
    for _ in range(_REPEATS):
        start_s = time.thread_time()
        orb.detectAndCompute(picture, None)
        spent_ms.append(1e3 * (time.thread_time() - start_s))
    cv2.setNumThreads(threads)
    return round(float(np.median(spent_ms)), 3)


def _picture() -> cv2.typing.MatLike:
    """Return random grey boxes, VGA: thousands of corners."""
    rng = np.random.default_rng(0)
    picture = np.zeros((480, 640), np.uint8)
    for x, y, width, height, grey in rng.integers(0, (640, 480, 60, 60, 256), (3000, 5)).tolist():
        picture[y : y + height, x : x + width] = grey
    return picture
