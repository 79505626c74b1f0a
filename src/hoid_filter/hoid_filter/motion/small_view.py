"""One image as motion is judged in it."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common.values import S_PER_NS, ByteArray, Float32Array
from hoid_filter.detections.aligned_detections import FilterInput
from hoid_filter.motion.small_camera import SmallCamera
from hoid_native import depth_segments
from hoid_native.results import Segments

_CELL_PX = 20  # what rests and touches what moves is lost with it, no further than this


class SmallView(NamedTuple):
    """The small images of a view, and its pieces: depth without jumps, cut into cells."""

    stamp_s: float
    gray: ByteArray  # (2h, 2w), about
    depth_m: Float32Array  # (h, w); 0 = no reading
    segments: Segments


def small_view(view: FilterInput, gray: ByteArray, camera: SmallCamera) -> SmallView:
    """Return the small images of a view and its (H, W) grey image."""
    depth_m = camera.depth(view.depth_m)
    segments = depth_segments(depth_m, _CELL_PX)
    return SmallView(view.stamp_ns * S_PER_NS, camera.gray(gray), depth_m, segments)
