"""Weak detections are kept where the object map expects an object of their class.

This is the prior of Detect-SLAM (Zhong et al., WACV 2018).
"""

from __future__ import annotations

import numpy as np

from hoid_common.values import NS_PER_S, BoolArray, Detections, Float32Array, IntArray
from hoid_native import intersections_over_union

_MIN_IOU = 0.5  # least overlap of a weak and an expected box; from a trial on six rendered rooms
# Chosen: older expected boxes are not used, because the camera has moved since.
_MAX_AGE_NS = NS_PER_S
# An expected and a confident box of the same class show the same object if their intersection over
# union is at least this. Such pairs measure how far the image has moved. Not tuned.
_MIN_IOU_SHIFTED = 0.1


def confirmed_rows(weak: Detections, strong: Detections, expected: Detections) -> IntArray:
    """Return the rows (M,) of weak boxes that show expected objects, at most one per object.

    The expected boxes are first shifted by the median image motion of detected objects. For each
    object, the best weak box of its class that overlaps it by half is returned, unless a strong
    box of any class overlaps it by half: the object is detected already.
    """
    if abs(weak.stamp_ns - expected.stamp_ns) >= _MAX_AGE_NS or not len(weak):
        return np.empty(0, np.int64)
    boxes_xyxy_px = expected.boxes_xyxy_px + np.tile(_shift_px(expected, strong), 2)
    is_seen = np.any(
        intersections_over_union(boxes_xyxy_px, strong.boxes_xyxy_px) >= _MIN_IOU,
        axis=1,
        keepdims=True,
    )
    fits = intersections_over_union(boxes_xyxy_px, weak.boxes_xyxy_px) >= _MIN_IOU
    fits &= _are_alike(expected, weak) & ~is_seen
    best = np.argmax(np.where(fits, weak.scores, -1.0), axis=1)
    return np.unique(best[fits.any(axis=1)])


def _shift_px(expected: Detections, strong: Detections) -> Float32Array:
    """Return the median shift (2,) in px from expected boxes to detections of them; 0 if none."""
    overlaps = intersections_over_union(expected.boxes_xyxy_px, strong.boxes_xyxy_px)
    overlaps = np.where(_are_alike(expected, strong), overlaps, 0)
    rows = np.flatnonzero((overlaps >= _MIN_IOU_SHIFTED).any(axis=1))
    if len(rows) == 0:
        return np.zeros(2, np.float32)
    pairs = strong.boxes_xyxy_px[overlaps[rows].argmax(axis=1)] - expected.boxes_xyxy_px[rows]
    return np.asarray(np.median((pairs[:, :2] + pairs[:, 2:]) / 2, axis=0), np.float32)


def _are_alike(first: Detections, second: Detections) -> BoolArray:
    names = np.array(first.class_names, str)[:, None] == np.array(second.class_names, str)
    return np.asarray(names)
