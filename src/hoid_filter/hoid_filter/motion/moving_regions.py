"""Moving regions of an image with box, depth and velocity, stored for the last images."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_filter.config import MotionConfig
from hoid_filter.motion.downscaled_camera import DownscaledCamera
from hoid_filter.motion.downscaled_view import MotionView
from hoid_filter.motion.motion_log_odds import LabeledRegions, dilate_labels
from hoid_filter.motion.motion_segmentation import MotionSegmentation

_MAX_RESULTS = 60  # chosen: two seconds at 30 Hz, more than the live filter re-evaluates


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


class MotionDetector:
    """Segments motion in the views of one camera, and stores the results of the last 60 views."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._segmentation: MotionSegmentation | None = None
        self._results: deque[tuple[int, MovingRegions]] = deque(maxlen=_MAX_RESULTS)

    def detect(self, view: MotionView) -> None:
        if self._segmentation is None or self._segmentation.camera.camera != view.camera:
            self._segmentation = MotionSegmentation(self._config, view.camera)
        regions = self._segmentation.segment(view)
        moving = (
            _describe(regions, self._segmentation) if regions.num_regions else NO_MOVING_REGIONS
        )
        moving = moving._replace(camera_turn_radps=self._segmentation.turn_radps)
        self._results.append((view.stamp_ns, moving))

    def has_result(self, stamp_ns: int) -> bool:
        return any(result_ns == stamp_ns for result_ns, _ in self._results)

    def regions_at(self, stamp_ns: int) -> MovingRegions:
        past = (moving for result_ns, moving in reversed(self._results) if result_ns <= stamp_ns)
        return next(past, NO_MOVING_REGIONS)


def _describe(regions: LabeledRegions, segmentation: MotionSegmentation) -> MovingRegions:
    depth_m = segmentation.depth_m
    depths_m = [np.median(depth_m[regions.label == n + 1]) for n in range(regions.num_regions)]
    return MovingRegions(
        segmentation.camera.boxes_px(regions.boxes_xywh_px).astype(np.float32),
        np.array(depths_m, np.float64),
        segmentation.displacements.region_velocities_mps(regions),
        dilate_labels(regions.label),
        segmentation.camera,
    )
