"""Predicts which map points an image should show if its estimated pose is right.

In a second place with identical furniture, many points are found, but more are missing, because
the walls differ. The number of found points is therefore compared with the expected number, to
which each point contributes its detection probability. Points without features around them (masked
people, blank walls) and points behind an occluding object do not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.matching.feature_grid import FeatureGrid
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.points import PointTable

# Not tuned.
_WINDOW_PX = 12.0  # half side of the window around a point in which features are compared
_MIN_READINGS = 2  # readings that contradict a point; a single one may be wrong at a depth edge
# A reading lies behind or in front of a point if their depths differ by more than noise and the
# slope of surfaces within the window explain: a constant part plus a share of the point's depth.
_DEPTH_TOLERANCE_M = 0.10
_DEPTH_TOLERANCE_SHARE = 0.12


class Visibility(NamedTuple):
    """Which of N points in the view of an image could be found in it, and which it contradicts."""

    # (N,) there are features near the point's pixel; if some of them have depth readings, not all
    # of these lie in front of the point, which would be occluded then.
    observable: BoolArray
    # (N,) there are at least two depth readings near the point's pixel, and all lie behind it.
    contradicted: BoolArray


def visibility(projection_px: FloatArray, depth_m: FloatArray, frame: Frame) -> Visibility:
    """Return which points are observable, and which are contradicted, by the features near them.

    Args:
        projection_px: (3, N) predicted u, v, u_right of the points.
        depth_m: (N,) depths of the points in the camera frame.
    """
    n = len(depth_m)
    q, k = FeatureGrid(frame).search(projection_px[:2], np.full(n, _WINDOW_PX))
    features = np.bincount(q, minlength=n)
    has_depth = frame.depth_m[k] > 0
    q, k = q[has_depth], k[has_depth]
    difference_m = frame.depth_m[k] - depth_m[q]
    tolerance_m = _DEPTH_TOLERANCE_M + _DEPTH_TOLERANCE_SHARE * depth_m[q]
    num_readings = np.bincount(q, minlength=n)
    num_behind = np.bincount(q, difference_m > tolerance_m, minlength=n)
    num_in_front = np.bincount(q, difference_m < -tolerance_m, minlength=n)
    is_occluded = (num_readings > 0) & (num_in_front == num_readings)
    is_contradicted = (num_readings >= _MIN_READINGS) & (num_behind == num_readings)
    return Visibility((features > 0) & ~is_occluded, is_contradicted)


def detection_probability(points: PointTable, j: IntArray) -> FloatArray:
    """Return the (N,) probabilities that a frame with points in rows (N,) in view finds them.

    It is the share of the earlier frames that found the point, with a Beta(1, 3) prior, whose mean
    is 1/4 (chosen, not tuned).
    """
    probability: FloatArray = (points.num_found[j] + 1.0) / (points.num_visible[j] + 4.0)
    return probability
