"""The mask over what moves: no larger than needed, and smaller when little else is left."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, Float32Array, Reason
from hoid_filter.config import PlusConfig
from hoid_filter.depth_regions import SHRINK, Box, DepthRegions, crop
from hoid_filter.interaction import Situation
from hoid_filter.scene import View

_PATCH_MARGIN_PX = 8  # features this near see what moves in their patch
_SAMPLE_STRIDE = 8
_COAST_MARGIN = 0.1  # share of its size by which a predicted box may be off
# How sure it is that what covers a pixel moves; the least sure is given back first.
_CERTAINTY = {
    Reason.REMEMBERED: 1,
    Reason.PREDICTED: 2,
    Reason.HANDLED: 2,
    Reason.PERSON: 3,
}


class Masks(NamedTuple):
    """Where features may lie and where map points may be made."""

    keep: ByteArray | None = None  # (H, W), 0 = moves; None = the whole image is static
    seed: ByteArray | None = None  # (H, W), 0 = no seeds; None = wherever features are
    step: int = 0  # how far the mask was relaxed


def make_masks(certainty: ByteArray, view: View, plus: PlusConfig, enough: float) -> Masks:
    """Return the masks of one image from what covers its pixels.

    While fewer than `enough` corners with depth are left, the mask gives back first its margin and
    what is only remembered, then objects and predictions, then everything. Seeds stay away from
    all of it: the tracker may look at a person's features, but the map never holds them.
    """
    if not certainty.any():
        return Masks()
    size_hw = view.depth_m.shape
    wide = _widen(certainty, _PATCH_MARGIN_PX)
    seed = _enlarge(_widen(wide, plus.seed_margin_px), size_hw) if plus.guard_seeds else None
    keep = _enlarge(wide, size_hw)
    if not plus.fall_back:
        return Masks(keep, seed)
    for step in range(max(_CERTAINTY.values())):
        if step > 0:
            keep = _enlarge((certainty > step).view(np.uint8), size_hw)
        if _leaves(keep, view, enough):
            return Masks(keep, seed, step)
    return Masks(None, _enlarge(wide, size_hw), step + 1)


def _leaves(keep: ByteArray, view: View, enough: float) -> bool:
    """Return whether enough corners with depth are left outside a mask.

    Corners without depth hold a pose by two equations, not three, and come late into the map.
    """
    for stride in (_SAMPLE_STRIDE, 1):  # mostly a sample of them is enough already
        left = view.corner_pixels[::stride]
        left = left[keep.ravel()[left] > 0]
        if np.count_nonzero(view.depth_m.ravel()[left] > 0) >= enough:
            return True
    return False


def cover(
    situation: Situation,
    reasons: tuple[Reason, ...],
    small_depth_m: Float32Array,
    plus: PlusConfig,
) -> ByteArray:
    """Return how sure it is that each pixel of the small image moves; 0 = static."""
    certainty = np.zeros(small_depth_m.shape, np.uint8)
    if all(reason is Reason.STATIC for reason in reasons):
        return certainty
    regions = DepthRegions(small_depth_m)
    of_region = np.zeros(regions.num, np.uint8)
    rows = zip(
        situation.tracks,
        reasons,
        situation.boxes_xyxy_px.tolist(),
        situation.depths_m.tolist(),
        strict=True,
    )
    for track, reason, box, depth_m in rows:
        if reason is Reason.STATIC:
            continue
        sure, value = reason is not Reason.PREDICTED, _CERTAINTY[reason]
        area = crop(box if sure else _grown(*box), certainty.shape)
        shown: BoolArray | bool = True
        if plus.keep_background and not math.isnan(depth_m):
            reach_m = plus.person_depth_m if track.is_person else plus.object_depth_m
            own = regions.shown_in(area, depth_m, reach_m)
            of_region[own] = np.maximum(of_region[own], value)
            shown = regions.pixels_in(area, own, depth_m, reach_m, sure=sure)
        np.maximum(certainty[area], value, out=certainty[area], where=shown)
    return np.maximum(certainty, of_region[regions.labels])


def _grown(x1: float, y1: float, x2: float, y2: float) -> Box:
    more_x, more_y = _COAST_MARGIN * (x2 - x1), _COAST_MARGIN * (y2 - y1)
    return x1 - more_x, y1 - more_y, x2 + more_x, y2 + more_y


def _widen(moves: ByteArray, margin_px: int) -> ByteArray:
    """Return 1 within a margin of what is not 0."""
    side = 2 * round(margin_px / SHRINK) + 1
    kernel = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(np.minimum(moves, 1), kernel), np.uint8)


def _enlarge(moves: ByteArray, size_hw: tuple[int, ...]) -> ByteArray:
    """Return the mask of full size, 255 where nothing moves."""
    small = np.where(moves, np.uint8(0), np.uint8(255))
    full = cv2.resize(small, size_hw[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(full, np.uint8)
