"""Moving regions of an image, with box, depth and velocity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera


class MovingRegions(NamedTuple):
    """N regions of one image that move in the world."""

    boxes_xyxy_px: Float32Array  # (N, 4) in the full image
    depths_m: FloatArray  # (N,) median depths
    velocities_mps: FloatArray  # (N, 3) relative to the world, along camera axes; NaN = unknown
    label: ByteArray  # (h, w) at low resolution: 0 = static, else 1 + index of the region
    camera: DownscaledCamera | None  # maps pixels to the label image; None: no regions
    camera_turn_radps: float = 0.0  # how fast the camera turns; 0 = unknown

    def label_at(self, pixels: IntArray) -> ByteArray:
        """Return the labels of flat full-image pixels: 0 = static, else 1 + index of region."""
        if self.camera is None or not len(self.depths_m):
            return np.zeros(pixels.shape, np.uint8)
        return self.label.ravel()[self.camera.downscaled_of_pixel[pixels]]

    def select(self, index: IntArray) -> MovingRegions:
        return self._replace(
            boxes_xyxy_px=self.boxes_xyxy_px[index],
            depths_m=self.depths_m[index],
            velocities_mps=self.velocities_mps[index],
        )


NO_MOVING_REGIONS = MovingRegions(
    np.empty((0, 4), np.float32), np.empty(0), np.empty((0, 3)), np.zeros((1, 1), np.uint8), None
)
