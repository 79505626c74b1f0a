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

# Chosen, 1/8 of the image: side of the grid cells at whose borders segments are cut. Static
# surface that touches a moving object is then masked with it in one cell at most.
_SEGMENT_CELL_PX = 20


class MotionView(NamedTuple):
    """A full-resolution gray and depth image with its corners, for motion segmentation."""

    stamp_ns: int
    camera: CameraModel
    image_gray: ByteArray  # (H, W)
    depth_m: Float32Array  # (H, W); 0 = no depth
    corner_pixels: IntArray  # (K,) FAST corners, as indices into the flattened image
    corner_scores: ByteArray  # (K,) strength of each corner
    # (h, w), at any resolution: dynamic objects that a detector has found in this image or in the
    # one before. None: there are none.
    detected_mask: BoolArray | None = None

    def is_detected(self, pixels: IntArray) -> BoolArray:
        """Return flags (N,): whether each pixel (flat index) lies on a detected dynamic object."""
        if self.detected_mask is None:
            return np.zeros(len(pixels), np.bool_)
        (height, width), (mask_height, mask_width) = self.depth_m.shape, self.detected_mask.shape
        rows = pixels // width * mask_height // height
        columns = pixels % width * mask_width // width
        flags: BoolArray = self.detected_mask[rows, columns]
        return flags


class DownscaledView(NamedTuple):
    """The low-resolution gray and depth images of a view, and its depth segments."""

    stamp_s: float
    gray: ByteArray  # about (2h, 2w), as its resolution is twice that of the depth image
    depth_m: Float32Array  # (h, w); 0 = no depth
    segments: Segments  # S pieces of smooth depth, cut along depth edges and a grid


def downscale(view: MotionView, camera: DownscaledCamera) -> DownscaledView:
    depth_m = camera.depth(view.depth_m)
    segments = depth_segments(depth_m, _SEGMENT_CELL_PX)
    gray = camera.gray(view.image_gray)
    return DownscaledView(view.stamp_ns * S_PER_NS, gray, depth_m, segments)
