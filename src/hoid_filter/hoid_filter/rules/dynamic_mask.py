"""The mask over what moves: no larger than needed, and smaller when little else is left."""

from __future__ import annotations

import functools
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, Float32Array, IntArray, Reason
from hoid_filter.config import PlusConfig
from hoid_filter.detections.aligned_detections import FilterInput
from hoid_filter.extraction.pyramid import Int32Array
from hoid_filter.rules.depth_regions import SHRINK, cells
from hoid_filter.rules.interaction import TrackSnapshot
from hoid_native import cover_things, values_at, widen

_PATCH_MARGIN_PX = 8  # features this near see what moves in their patch
_SAMPLE_STRIDES = (32, 8, 1)
_COAST_MARGIN = 0.1  # share of its size by which a predicted box may be off
# How sure it is that what covers a pixel moves; the least sure is given back first.
_CERTAINTY = {
    Reason.REMEMBERED: 1,
    Reason.PREDICTED: 2,
    Reason.HANDLED: 2,
    Reason.MOVING: 2,
    Reason.PERSON: 3,
}
# How near a pixel is to what moves; what is added to the last says how sure it is that it moves.
_FREE, _NEAR = 0, 1
# What the mask lets pass, and ever more of it while too little is left.
_LIMITS = (
    _FREE,
    _NEAR + _CERTAINTY[Reason.REMEMBERED],
    _NEAR + _CERTAINTY[Reason.HANDLED],
)


class Masks(NamedTuple):
    """Where features may lie and where map points may be made, at a view's K corners."""

    static_area_px: int  # of the image
    kept: IntArray | None = None  # of the K corners, ascending, what is static; None = all
    seeds: BoolArray | None = None  # (K,), False = no map point; None = all that are kept
    step: int = 0  # how far the mask was relaxed
    moves: BoolArray | None = None  # (h, w) of the small image, what is masked; None = nothing


def make_masks(confidence: ByteArray, view: FilterInput, plus: PlusConfig, enough: float) -> Masks:
    """Return the masks of one image from what covers its pixels.

    While fewer than `enough` corners with depth are left, the mask gives back first its margin and
    what is only remembered, then objects and predictions, then everything. What was given back
    makes no map points: the tracker may look at a person's features, but the map never holds them.
    All else makes some, up to the margin: a feature that is kept and not mapped holds no pose, and
    takes the budget of one that would.
    """
    size_px = view.depth_m.size
    if not confidence.any():
        return Masks(size_px)
    grid = _grid(view.depth_m.shape, confidence.shape)
    nearness = widen(confidence, round(_PATCH_MARGIN_PX / SHRINK)) + confidence
    at_corner = values_at(view.corner_pixels, nearness, grid.rows, grid.columns)
    is_free = at_corner == _FREE
    for step, limit in enumerate(_LIMITS):
        kept = np.flatnonzero(at_corner <= limit)
        if not plus.fall_back or _leaves(kept, view, enough):
            seeds = is_free if step else None
            moves = nearness > limit
            return Masks(size_px - grid.area_px(moves), kept, seeds, step, moves)
    return Masks(size_px, None, is_free, len(_LIMITS))


def _leaves(kept: IntArray, view: FilterInput, enough: float) -> bool:
    """Return whether enough corners with depth are left outside a mask.

    Corners without depth hold a pose by two equations, not three, and come late into the map.
    """
    depth_m = view.depth_m.ravel()
    for stride in _SAMPLE_STRIDES:  # mostly a sample of them is enough already
        left = view.corner_pixels[kept[::stride]]
        if np.count_nonzero(depth_m[left] > 0) >= enough:
            return True
    return False


class _Grid(NamedTuple):
    """How the small image covers the full one, cell by cell."""

    rows: IntArray  # (H,) row of cells at each row of pixels
    columns: IntArray  # (W,) column of cells at each column of pixels
    areas_px: Int32Array  # (h, w) of the cells

    def area_px(self, cells: BoolArray) -> int:
        """Return the area of (h, w) cells."""
        return int(self.areas_px[cells].sum())


@functools.cache
def _grid(size_hw: tuple[int, int], small_hw: tuple[int, int]) -> _Grid:
    rows, columns = (_nearest(*sizes) for sizes in zip(size_hw, small_hw, strict=True))
    heights, widths = np.bincount(rows), np.bincount(columns)
    areas_px = np.outer(heights, widths).astype(np.int32)
    return _Grid(rows, columns, areas_px)


def _nearest(size: int, small_size: int) -> IntArray:
    """Return the (size,) positions that OpenCV takes from a small row when it enlarges it."""
    row = np.arange(small_size, dtype=np.float32)[None]
    enlarged = cv2.resize(row, (size, 1), interpolation=cv2.INTER_NEAREST)
    return np.asarray(enlarged[0], np.int64)


def dynamic_confidence_mask(
    snapshot: TrackSnapshot,
    reasons: tuple[Reason, ...],
    small_depth_m: Float32Array,
    plus: PlusConfig,
) -> ByteArray:
    """Return how sure it is that each pixel of the small image moves; 0 = static."""
    moving = [n for n, reason in enumerate(reasons) if reason is not Reason.STATIC]
    if not moving:
        return np.zeros(small_depth_m.shape, np.uint8)
    seen = np.array([reasons[n] is not Reason.PREDICTED for n in moving], np.bool_)
    is_person = [snapshot.tracks[n].is_person for n in moving]
    boxes = snapshot.boxes_xyxy_px[moving]
    more = _COAST_MARGIN * (boxes[:, 2:] - boxes[:, :2]) * ~seen[:, None]
    boxes[:, :2] -= more
    boxes[:, 2:] += more
    return cover_things(
        small_depth_m,
        cells(boxes, small_depth_m.shape),
        snapshot.depths_m[moving] if plus.keep_background else np.full(len(moving), np.nan),
        np.where(is_person, plus.person_depth_m, plus.object_depth_m),
        np.array([_CERTAINTY[reasons[n]] for n in moving], np.uint8),
        seen,
    )


def moving_confidence(label: ByteArray) -> ByteArray:
    """Return how sure it is that each pixel of a small image moves, from (h, w) labels of regions.

    Args:
        label: 0 = rests.
    """
    return (label > 0).astype(np.uint8) * np.uint8(_CERTAINTY[Reason.MOVING])
