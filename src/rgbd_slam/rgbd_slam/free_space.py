"""Evidence against a match of two places: points where the image sees through.

Where the same furniture stands twice, features match in number, but what surrounds it differs. A
point of the map is contradicted when every depth reading around its pixel lies beyond it. The
other way round is no evidence: people and things may stand in front.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.feature_grid import FeatureGrid
from rgbd_slam.frame import Frame

_WINDOW_PX = 12.0
_MIN_READINGS = 2  # a single one may be a false reading at an edge
_GAP_SHARE = 0.12  # of the depth, beyond which two readings differ: noise and parallax stay within
_GAP_M = 0.10


class FreeSpace(NamedTuple):
    """What the depth readings of an image say about N points."""

    agree: BoolArray  # (N,) some reading near the pixel has the point's depth
    contradict: BoolArray  # (N,) all readings near the pixel lie beyond the point


def check_free_space(projection_px: FloatArray, depth_m: FloatArray, frame: Frame) -> FreeSpace:
    """Compare points with the depth readings of the features around them.

    Args:
        projection_px: (3, N) where the points are seen.
        depth_m: (N,) of the points.
    """
    n = len(depth_m)
    q, k = FeatureGrid(frame).search(projection_px[:2], np.full(n, _WINDOW_PX))
    read = frame.depth_m[k] > 0
    q, k = q[read], k[read]
    gap = frame.depth_m[k] - depth_m[q]
    tolerance = _GAP_M + _GAP_SHARE * depth_m[q]
    count = np.bincount(q, minlength=n)
    beyond = np.bincount(q, gap > tolerance, minlength=n)
    close = np.bincount(q, np.abs(gap) <= tolerance, minlength=n)
    return FreeSpace(close > 0, (count >= _MIN_READINGS) & (beyond == count))
