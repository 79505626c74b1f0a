"""One image as motion is judged in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import (
    S_PER_NS,
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    IntArray,
)
from hoid_filter.motion.small_camera import SmallCamera
from hoid_native import FlowPyramid, depth_segments
from hoid_native.results import Segments

FLOW_LEVELS = 3  # of the grey image, in which points are followed
_CELL_PX = 20  # what rests and touches what moves is lost with it, no further than this


class MotionView(NamedTuple):
    """One image as motion is looked for in it."""

    stamp_ns: int
    camera: CameraModel
    image_gray: ByteArray  # (H, W)
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) of the corners found, as indices in the flat image
    corner_scores: ByteArray  # (K,), higher is stronger
    detected: BoolArray | None = None  # (h, w) of a small image, on what is known not to rest

    def is_detected(self, pixels: IntArray) -> BoolArray:
        """Return whether each of (N,) flat pixels of the image is on what is known not to rest."""
        if self.detected is None:
            return np.zeros(len(pixels), np.bool_)
        (height, width), (small_height, small_width) = self.depth_m.shape, self.detected.shape
        rows = pixels // width * small_height // height
        columns = pixels % width * small_width // width
        on_it: BoolArray = self.detected[rows, columns]
        return on_it


class SmallView(NamedTuple):
    """The small images of a view, and its pieces: depth without jumps, cut into cells."""

    stamp_s: float
    gray: FlowPyramid  # of (2h, 2w) pixels, about
    depth_m: Float32Array  # (h, w); 0 = no reading
    segments: Segments


def small_view(view: MotionView, camera: SmallCamera) -> SmallView:
    """Return the small images of a view."""
    depth_m = camera.depth(view.depth_m)
    segments = depth_segments(depth_m, _CELL_PX)
    gray = FlowPyramid(camera.gray(view.image_gray), FLOW_LEVELS)
    return SmallView(view.stamp_ns * S_PER_NS, gray, depth_m, segments)
