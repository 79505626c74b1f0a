"""The mask over dynamic objects, which is relaxed when too few corners are left outside it."""

from __future__ import annotations

import functools
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, Float32Array, IntArray, Reason
from hoid_filter.config import PlusConfig
from hoid_filter.extraction.pyramid import Int32Array
from hoid_filter.strategies.depth_regions import STRIDE_PX, subsampled_boxes
from hoid_filter.strategies.interaction import TrackSnapshot
from hoid_filter.strategy import FilterInput
from hoid_native import segment_objects, values_at

# Chosen: within this distance the descriptor patch of a static corner shows the moving object.
_MARGIN_PX = 8
_MARGIN_KERNEL = np.ones((2 * round(_MARGIN_PX / STRIDE_PX) + 1,) * 2, np.uint8)
_SAMPLE_STRIDES = (32, 8, 1)  # of the corners that are counted, until enough are found
_PREDICTION_MARGIN = 0.1  # chosen: a predicted box may be off by this share of its sides
# How certain it is that an object with this reason moves. The least certain is unmasked first.
_CERTAINTY = {
    Reason.REMEMBERED: 1,
    Reason.PREDICTED: 2,
    Reason.HANDLED: 2,
    Reason.MOVING: 2,
    Reason.PERSON: 3,
}
# Levels of a pixel: static, in the margin, or margin plus the certainty of the object on it.
_STATIC, _MARGIN = 0, 1
# Greatest level that is kept, by step of relaxation.
_KEPT_LEVELS = (
    _STATIC,
    _MARGIN + _CERTAINTY[Reason.REMEMBERED],
    _MARGIN + _CERTAINTY[Reason.HANDLED],
)


class Masks(NamedTuple):
    """Which of an image's K corners are kept, and which may become map points."""

    static_area_px: int  # unmasked area of the image
    kept: IntArray | None = None  # indices of the kept corners, ascending; None = all
    seeds: BoolArray | None = None  # (K,) corners that may become map points; None = all kept ones
    step: int = 0  # of relaxation
    dynamic: BoolArray | None = None  # (h, w) at low resolution; None = nothing is masked


def make_masks(
    certainty: ByteArray, image: FilterInput, plus: PlusConfig, min_corners: float
) -> Masks:
    """Return the masks of an image, relaxed until enough corners with depth are left.

    The mask gives back first its margin and remembered objects, then handled and predicted ones,
    at last everything. Corners that were given back do not become map points (decision 12):
    tracking on a person for a moment is better than losing track, but the map must stay static.

    Args:
        certainty: (h, w) how certain it is that each low-resolution pixel moves; 0 = static.
        image: The image.
        plus: Has the switch of relaxation.
        min_corners: The corners with depth that are enough.
    """
    size_px = image.depth_m.size
    if not certainty.any():
        return Masks(size_px)
    grid = _upsampling(image.depth_m.shape, certainty.shape)
    level = (cv2.dilate(certainty, _MARGIN_KERNEL) > 0) + certainty
    level_at_corner = values_at(image.corner_pixels, level, grid.rows, grid.columns)
    is_static = level_at_corner == _STATIC
    for step, limit in enumerate(_KEPT_LEVELS):
        kept = np.flatnonzero(level_at_corner <= limit)
        if not plus.fall_back or _has_enough_corners(kept, image, min_corners):
            seeds = is_static if step else None
            dynamic = level > limit
            return Masks(size_px - grid.area_px(dynamic), kept, seeds, step, dynamic)
    return Masks(size_px, None, is_static, len(_KEPT_LEVELS))


def _has_enough_corners(kept: IntArray, image: FilterInput, min_corners: float) -> bool:
    """Return whether at least `min_corners` of the kept corners have depth.

    A corner without depth constrains a pose by two equations instead of three, and becomes a map
    point only when it is triangulated.
    """
    depth_m = image.depth_m.ravel()
    for stride in _SAMPLE_STRIDES:  # a sample is mostly enough already
        pixels = image.corner_pixels[kept[::stride]]
        if np.count_nonzero(depth_m[pixels] > 0) >= min_corners:
            return True
    return False


class _Upsampling(NamedTuple):
    """The low-resolution cell of each pixel, as in nearest-neighbor resizing."""

    rows: IntArray  # (H,) row of cells of each row of pixels
    columns: IntArray  # (W,) column of cells of each column of pixels
    areas_px: Int32Array  # (h, w) of the cells

    def area_px(self, mask: BoolArray) -> int:
        """Return the full-resolution area of an (h, w) mask."""
        return int(self.areas_px[mask].sum())


@functools.cache
def _upsampling(size_hw: tuple[int, int], low_hw: tuple[int, int]) -> _Upsampling:
    rows, columns = (_nearest(*sizes) for sizes in zip(size_hw, low_hw, strict=True))
    heights, widths = np.bincount(rows), np.bincount(columns)
    areas_px = np.outer(heights, widths).astype(np.int32)
    return _Upsampling(rows, columns, areas_px)


def _nearest(size: int, low_size: int) -> IntArray:
    """Return the (size,) indices into a low-resolution row that OpenCV's resizing takes."""
    row = np.arange(low_size, dtype=np.float32)[None]
    enlarged = cv2.resize(row, (size, 1), interpolation=cv2.INTER_NEAREST)
    return np.asarray(enlarged[0], np.int64)


def dynamic_certainty(
    snapshot: TrackSnapshot,
    reasons: tuple[Reason, ...],
    low_depth_m: Float32Array,
    plus: PlusConfig,
) -> ByteArray:
    """Return (h, w): how certain it is that each pixel lies on a dynamic object; 0 = static.

    An object is the part of its box near its depth, so that the background in the box is kept.

    Args:
        snapshot: N tracks.
        reasons: Why each is dynamic, or that it is static.
        low_depth_m: (h, w) subsampled depth.
        plus: Has the depth extent of people and objects.
    """
    dynamic = [n for n, reason in enumerate(reasons) if reason is not Reason.STATIC]
    if not dynamic:
        return np.zeros(low_depth_m.shape, np.uint8)
    is_seen = np.array([reasons[n] is not Reason.PREDICTED for n in dynamic], np.bool_)
    is_person = [snapshot.tracks[n].is_person for n in dynamic]
    boxes = snapshot.boxes_xyxy_px[dynamic]
    margin = _PREDICTION_MARGIN * (boxes[:, 2:] - boxes[:, :2]) * ~is_seen[:, None]
    boxes[:, :2] -= margin
    boxes[:, 2:] += margin
    return segment_objects(
        low_depth_m,
        subsampled_boxes(boxes, low_depth_m.shape),
        snapshot.depths_m[dynamic] if plus.keep_background else np.full(len(dynamic), np.nan),
        np.where(is_person, plus.person_depth_m, plus.object_depth_m),
        np.array([_CERTAINTY[reasons[n]] for n in dynamic], np.uint8),
        is_seen,
    )


def moving_certainty(label: ByteArray) -> ByteArray:
    """Return (h, w) how certain it is that pixels move, from labels of moving regions.

    Args:
        label: (h, w), 0 = static.
    """
    return (label > 0).astype(np.uint8) * np.uint8(_CERTAINTY[Reason.MOVING])
