"""What moves, as regions with a box and a depth, and as a picture of where."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from hoid_common.median import median
from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_filter.config import MotionConfig
from hoid_filter.motion.belief import MovingArea, widened
from hoid_filter.motion.motion_segmentation import MotionSegmentation
from hoid_filter.motion.small_camera import SmallCamera
from hoid_filter.motion.small_view import MotionView

_REMEMBERED = 60  # views that may be asked for


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
    """Finds what moves in views of one camera, and remembers it for a while."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._segmentation: MotionSegmentation | None = None
        self._sensed: deque[tuple[int, Moving]] = deque(maxlen=_REMEMBERED)

    def sense(self, view: MotionView) -> None:
        """Find what moves in a view; views come in order of time, and another camera anew."""
        if self._segmentation is None or self._segmentation.camera.camera != view.camera:
            self._segmentation = MotionSegmentation(self._config, view.camera)
        area = self._segmentation.observe(view)
        moving = _described(area, self._segmentation) if area.num_regions else NOTHING
        self._sensed.append((view.stamp_ns, moving))

    def has_sensed(self, stamp_ns: int) -> bool:
        """Return whether a view of the stamp was among the last."""
        return any(sensed_ns == stamp_ns for sensed_ns, _ in self._sensed)

    def at(self, stamp_ns: int) -> Moving:
        """Return what moves at a stamp, by the last view until then."""
        past = (moving for sensed_ns, moving in reversed(self._sensed) if sensed_ns <= stamp_ns)
        return next(past, NOTHING)


def _described(area: MovingArea, segmentation: MotionSegmentation) -> Moving:
    depth_m = segmentation.depth_m
    depths_m = [median(depth_m[area.label == n + 1]) for n in range(area.num_regions)]
    return Moving(
        segmentation.camera.boxes_px(area.boxes_xywh_px).astype(np.float32),
        np.array(depths_m, np.float64),
        segmentation.course.velocities_mps(area),
        widened(area.label),
        segmentation.camera,
    )
