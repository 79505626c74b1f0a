"""Where a part of the view is that drags the pose: without it all the rest would fit better.

What moves slowly by itself fits the pose of all matches nearly as well as what rests, so that
residuals do not tell the two apart. Its equations do: without them the pose of the rest moves, and
the cost of the rest falls by more than noise explains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.projection import MIN_DEPTH_M

_MARGIN = np.array([0.02, 0.02, 0.05])  # around a region, of directions and log depth


class Region(NamedTuple):
    """A box of directions x / z and y / z, and of the logarithm of depth, in the camera."""

    low: FloatArray  # (3,)
    high: FloatArray

    def holds(
        self, camera: StereoCamera, measured_px: Float32Array, depth_m: Float32Array
    ) -> BoolArray:
        """Return (N,) which features lie in it or near; without depth, by their direction."""
        u, v = measured_px[:, :2].T
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        at = np.stack([x, y, np.log(np.maximum(depth_m, MIN_DEPTH_M))])
        low, high = self.low - _MARGIN, self.high + _MARGIN
        inside = (low[:, None] <= at) & (at <= high[:, None])
        inside[2] |= depth_m <= 0
        return np.asarray(inside.all(0))
