"""The image in which motion is segmented, at full and at low resolution."""

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
from hoid_filter.motion.downscaled_camera import DownscaledCamera
from hoid_native import depth_segments
from hoid_native.results import Segments

# Chosen: side of the grid that cuts segments, 1/8 of the image. Static surface that touches a
# moving object is masked with it no further than one cell.
_SEGMENT_CELL_PX = 20


class MotionView(NamedTuple):
    """One full-resolution image for motion segmentation."""

    stamp_ns: int
    camera: CameraModel
    image_gray: ByteArray  # (H, W)
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) FAST corners, as indices into the flattened image
    corner_scores: ByteArray  # (K,), higher is stronger
    detected_mask: BoolArray | None = None  # (h, w) at any resolution: detected dynamic objects

    def is_detected(self, pixels: IntArray) -> BoolArray:
        """Return (N,) flags of the pixels, given as flat indices, on a detected dynamic object."""
        if self.detected_mask is None:
            return np.zeros(len(pixels), np.bool_)
        (height, width), (mask_height, mask_width) = self.depth_m.shape, self.detected_mask.shape
        rows = pixels // width * mask_height // height
        columns = pixels % width * mask_width // width
        flags: BoolArray = self.detected_mask[rows, columns]
        return flags


class DownscaledView(NamedTuple):
    """The low-resolution images of a view, and its depth segments."""

    stamp_s: float
    gray: ByteArray  # (2h, 2w), about: at twice the resolution of the depth
    depth_m: Float32Array  # (h, w); 0 = no reading
    segments: Segments  # S pieces of smooth depth, cut along depth edges and a grid


def downscale(view: MotionView, camera: DownscaledCamera) -> DownscaledView:
    """Return the low-resolution images of a view."""
    depth_m = camera.depth(view.depth_m)
    segments = depth_segments(depth_m, _SEGMENT_CELL_PX)
    gray = camera.gray(view.image_gray)
    return DownscaledView(view.stamp_ns * S_PER_NS, gray, depth_m, segments)
