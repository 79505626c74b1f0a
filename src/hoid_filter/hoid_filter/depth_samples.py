"""Depth of a detected object, read from a small sample box at the centre of its box."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array, FloatArray
from hoid_filter.overlap import Boxes


def sample_depths_m(depth_m: Float32Array, boxes_xyxy_px: Boxes, sample_box_px: int) -> FloatArray:
    """Return the (N,) median depths of the sample boxes; NaN where there is no reading at all.

    Args:
        depth_m: (H, W); 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), centres inside the image.
        sample_box_px: side of the sample box; beyond the image it sees the image's edge.
    """
    if len(boxes_xyxy_px) == 0:
        return np.empty(0)
    height, width = depth_m.shape
    corner = (boxes_xyxy_px[:, :2] + boxes_xyxy_px[:, 2:] - sample_box_px) / 2
    first = np.rint(corner).astype(np.int64)
    steps = np.arange(sample_box_px)
    column = np.minimum(np.maximum(first[:, :1] + steps, 0), width - 1)
    row = np.minimum(np.maximum(first[:, 1:] + steps, 0), height - 1)
    flat = (row[:, :, None] * width + column[:, None, :]).reshape(len(first), -1)
    readings = depth_m.ravel()[flat]
    known = readings > 0  # NaN > 0 is false
    readings[~known] = np.inf
    readings.sort(axis=1)
    num = np.count_nonzero(known, axis=1)
    index = np.arange(len(first))
    lower = readings[index, np.maximum(num - 1, 0) // 2].astype(np.float64)
    upper = readings[index, np.minimum(num // 2, sample_box_px**2 - 1)].astype(np.float64)
    middle: FloatArray = np.where(num > 0, (lower + upper) / 2, np.nan)
    return middle
