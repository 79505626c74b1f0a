"""What an image should show of the map if it was taken where it is thought to be.

Where the same furniture stands twice, many points are found, but more are missing: what hangs on
the walls differs. So the points found are held against those that should have been, by how often
each has been found before, leaving out what the image cannot tell: points where it has no
features (people are masked, walls may be blank) and points that something in front hides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.matching.feature_grid import FeatureGrid
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.points import PointTable

_WINDOW_PX = 12.0
_MIN_READINGS = 2  # a single one may be a false reading at an edge
_GAP_SHARE = 0.12  # of the depth, beyond which two readings differ: noise and parallax stay within
_GAP_M = 0.10


class Visibility(NamedTuple):
    """What the features of an image say about N points in its view."""

    observable: BoolArray  # (N,) there are features around, and not all are in front
    contradicted: BoolArray  # (N,) all depth readings around lie beyond: the image sees through


def visibility(projection_px: FloatArray, depth_m: FloatArray, frame: Frame) -> Visibility:
    """Compare points with the depth readings of the features around them.

    Args:
        projection_px: (3, N) where the points are seen.
        depth_m: (N,) of the points.
    """
    n = len(depth_m)
    q, k = FeatureGrid(frame).search(projection_px[:2], np.full(n, _WINDOW_PX))
    features = np.bincount(q, minlength=n)
    read = frame.depth_m[k] > 0
    q, k = q[read], k[read]
    gap = frame.depth_m[k] - depth_m[q]
    tolerance = _GAP_M + _GAP_SHARE * depth_m[q]
    count = np.bincount(q, minlength=n)
    beyond = np.bincount(q, gap > tolerance, minlength=n)
    before = np.bincount(q, gap < -tolerance, minlength=n)
    hidden = (count > 0) & (before == count)
    return Visibility((features > 0) & ~hidden, (count >= _MIN_READINGS) & (beyond == count))


def chance_found(points: PointTable, j: IntArray) -> FloatArray:
    """Return (N,) how likely a frame that should see the points finds each.

    That is the share of frames that did, drawn towards 1/4 while few frames tell.
    """
    chance: FloatArray = (points.num_found[j] + 1.0) / (points.num_visible[j] + 4.0)
    return chance
