"""Depth of what boxes show."""

from __future__ import annotations

from ctypes import c_int32, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_native.library import declare

_sample_depths = declare(
    'hoid_sample_depths', c_void_p, *[c_int32] * 3, c_void_p, c_int32, c_void_p
)


def sample_depths_m(
    depth_m: NDArray[np.float32], boxes_xyxy_px: NDArray[Any], side_px: int
) -> NDArray[np.float64]:
    """Return the (N,) median readings of squares at the centres of boxes; NaN without any.

    Args:
        depth_m: (H, W), not empty; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite.
        side_px: side of a square; beyond the image it sees the image's edge.

    """
    depth = np.ascontiguousarray(depth_m, np.float32)
    boxes = np.ascontiguousarray(boxes_xyxy_px, np.float64)
    height, width = depth.shape
    out = np.empty(len(boxes))
    _sample_depths(
        depth.ctypes.data, width, height, len(boxes), boxes.ctypes.data, side_px, out.ctypes.data
    )
    return out
