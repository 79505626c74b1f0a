"""A region of the camera's view, bounded in direction and depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import BoolArray, Float32Array, FloatArray
from rgbd_slam.model.frame import StereoCamera

# Chosen, not tuned: how far beyond the outermost matches a moving object may extend: 0.02 in
# x / z and y / z (10 px at a focal length of 520 px) and 5 % in depth.
_MARGIN = np.array([0.02, 0.02, 0.05])


class ViewRegion(NamedTuple):
    """A box in the coordinates x / z, y / z and log z of the camera frame, with z in m."""

    low: FloatArray  # (3,) lower bounds
    high: FloatArray  # (3,) upper bounds

    def contains(
        self, camera: StereoCamera, measured_px: Float32Array, depth_m: Float32Array
    ) -> BoolArray:
        """Return the (N,) mask of features in or near the region.

        Args:
            camera: The camera.
            measured_px: (N, 3) u, v, u_right of the features.
            depth_m: (N,) depths of the features; 0: none, tested by direction only.
        """
        u, v = measured_px[:, :2].T
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        location = np.stack([x, y, np.log(np.maximum(depth_m, MIN_DEPTH_M))])
        low, high = self.low - _MARGIN, self.high + _MARGIN
        is_inside = (low[:, None] <= location) & (location <= high[:, None])
        is_inside[2] |= depth_m <= 0
        return np.asarray(is_inside.all(0))
