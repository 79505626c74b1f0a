"""What moves, as regions with a box and a depth, and as a picture of where."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_filter.config import MotionConfig
from hoid_filter.detections.aligned_detections import FilterInput
from hoid_filter.motion.belief import MovingArea, widened
from hoid_filter.motion.motion_segmentation import MotionSegmentation
from hoid_filter.motion.small_camera import SmallCamera


class Moving(NamedTuple):
    """N regions that move."""

    boxes_xyxy_px: Float32Array  # (N, 4) in the full image
    depths_m: FloatArray  # (N,), median
    velocities_mps: FloatArray  # (N, 3) against the world along the camera's axes; NaN = unknown
    label: ByteArray  # (h, w) of the small image: 0 = rests, else 1 + index of the region
    camera: SmallCamera | None  # None: nothing is known

    def label_at(self, pixels: IntArray) -> ByteArray:
        """Return the labels of pixels, of any shape, given as indices in the flat full image."""
        if self.camera is None or not len(self.depths_m):
            return np.zeros(pixels.shape, np.uint8)
        return self.label.ravel()[self.camera.small_pixels(pixels)]

    def select(self, kept: IntArray) -> Moving:
        """Return some of the regions, by index; the picture of them all stays."""
        return self._replace(
            boxes_xyxy_px=self.boxes_xyxy_px[kept],
            depths_m=self.depths_m[kept],
            velocities_mps=self.velocities_mps[kept],
        )


NOTHING = Moving(
    np.empty((0, 4), np.float32), np.empty(0), np.empty((0, 3)), np.zeros((1, 1), np.uint8), None
)


class MotionSense:
    """Tells what moves in views of one camera, and begins anew with another."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._segmentation: MotionSegmentation | None = None

    def sense(self, view: FilterInput) -> Moving:
        """Return what moves; nothing while the camera is not known."""
        if view.appearance is None:
            return NOTHING
        camera = view.appearance.camera
        if self._segmentation is None or self._segmentation.camera.camera != camera:
            self._segmentation = MotionSegmentation(self._config, camera)
        area = self._segmentation.observe(view, view.appearance)
        return _described(area, self._segmentation) if area.num_regions else NOTHING


def _described(area: MovingArea, segmentation: MotionSegmentation) -> Moving:
    boxes, depths = [], []
    camera, depth_m = segmentation.camera, segmentation.depth_m
    for n in range(1, area.num_regions + 1):
        own = area.label == n
        boxes.append(camera.box_px(own))
        depths.append(float(np.median(depth_m[own])))
    return Moving(
        np.array(boxes, np.float32),
        np.array(depths),
        segmentation.course.velocities_mps(area),
        widened(area.label),
        camera,
    )
