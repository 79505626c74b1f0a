"""A fixed computation whose time is the unit of cost on a machine."""

from __future__ import annotations

import time

import cv2
import numpy as np

_REPEATS = 15


def reference_ms() -> float:
    """Return the thread CPU time (ms) of OpenCV's ORB with 1000 features on a fixed image.

    Multiples of this time can be compared across machines. It is the median of several calls in
    the process whose cost is measured.
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
    """Return a VGA image of random gray boxes, which have thousands of corners."""
    rng = np.random.default_rng(0)
    picture = np.zeros((480, 640), np.uint8)
    for x, y, width, height, gray in rng.integers(0, (640, 480, 60, 60, 256), (3000, 5)).tolist():
        picture[y : y + height, x : x + width] = gray
    return picture
