"""ORB features of an RGB-D image, distributed evenly over its unmasked part."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from hoid_common.io.depth import is_reading
from hoid_common.values import (
    DESCRIPTOR_BYTES,
    BoolArray,
    ByteArray,
    Features,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_filter.config import ExtractionConfig
from hoid_filter.extraction.pyramid import Corners, Int32Array, Pyramid, build_pyramid
from hoid_native import (
    fast_corners,
    orb_descriptors,
    orientations_deg,
    spread_evenly,
    subpixel_offsets_px,
)

_NO_BOXES: Float32Array = np.empty((0, 4), np.float32)
# `fast_corners` finds nothing on a level with a side below this inside its border.
_MIN_SIDE_PX = 32
_SMOOTHING = cv2.getGaussianKernel(7, 2.0)  # before BRIEF comparisons, as in OpenCV's ORB


class OrbExtractor:
    """Detects, distributes and describes corners of an image pyramid (Rublee et al., 2011)."""

    def __init__(self, config: ExtractionConfig) -> None:
        self._config = config
        self._budgets = octave_budgets(config.num_features, config.num_levels, config.scale_factor)

    def detect(self, image_gray: ByteArray) -> Corners:
        """Return the FAST corners of a gray image (H, W) on all levels of its pyramid.

        Levels with fewer corners than wanted features also get corners of low contrast.
        """
        config = self._config
        pyramid = build_pyramid(image_gray, config.num_levels, config.scale_factor)
        corners = Corners(
            pyramid, *fast_corners(*pyramid, config.fast_threshold, config.border_px)
        )
        if config.adapt_levels:
            lacks = self._counts(corners) < self._budgets_of(corners)
        else:
            lacks = np.full(config.num_levels, len(corners) < config.num_features)
        return self._with_weak_corners(corners, lacks) if lacks.any() else corners

    def _with_weak_corners(self, corners: Corners, lacks: BoolArray) -> Corners:
        """Return `corners` and those of low contrast on the levels where `lacks` (L,) is set."""
        config, pyramid = self._config, corners.pyramid
        first = int(np.argmax(lacks))
        coarse = Pyramid(pyramid.levels[first:], pyramid.steps_px[first:])
        weak = fast_corners(*coarse, config.low_fast_threshold, config.border_px)
        octave = weak.octave + np.uint8(first)
        added = np.flatnonzero(lacks[octave] | (weak.score >= config.fast_threshold))
        uv_px = weak.uv_px.take(added, axis=0)
        u, v = np.rint(uv_px).astype(np.int64).T
        num_kept = int(np.searchsorted(corners.octave, first))
        return Corners(
            pyramid,
            np.concatenate([corners.xy_px[:num_kept], weak.xy_px.take(added, axis=0)]),
            np.concatenate([corners.uv_px[:num_kept], uv_px]),
            np.concatenate([corners.pixel[:num_kept], v * pyramid.levels[0].shape[1] + u]),
            np.concatenate([corners.octave[:num_kept], octave[added]]),
            np.concatenate([corners.score[:num_kept], weak.score[added]]),
        )

    def _counts(self, corners: Corners) -> IntArray:
        """Return the numbers (L,) of corners per level, without those of low contrast."""
        octave = corners.octave[corners.score >= self._config.fast_threshold]
        return np.bincount(octave, minlength=self._config.num_levels)

    def _budgets_of(self, corners: Corners) -> IntArray:
        """Return how many features (L,) are wanted from each pyramid level of this image."""
        config = self._config
        if not config.adapt_levels:
            return self._budgets
        counts = self._counts(corners)
        weights = self._budgets * structure_shares(counts, corners.pyramid, config.border_px)
        return _in_proportion(weights, config.num_features)

    def choose(self, corners: Corners, kept: IntArray | None, static_area_px: int) -> IntArray:
        """Return the ascending indices of the corners to describe, distributed evenly.

        `kept` has the indices of the corners on static surface (None: all). With `refill`, all
        wanted features come from these (decision 014). Without it, they are chosen from all
        corners, and those that are not in `kept` are then dropped.
        """
        uv_px, octave, score = corners.uv_px, corners.octave, corners.score
        budgets = self._budgets_of(corners)
        if kept is not None and self._config.refill:
            uv_px = uv_px.take(kept, axis=0)  # 40 times as fast as indexing
            octave, score = octave[kept], score[kept]
            return kept[spread_evenly(uv_px, octave, score, budgets, static_area_px)]
        size_px = corners.pyramid.levels[0].size
        chosen = spread_evenly(uv_px, octave, score, budgets, size_px)
        return chosen if kept is None else np.intersect1d(chosen, kept, assume_unique=True)

    def describe(
        self,
        corners: Corners,
        chosen: IntArray,
        depth_m: Float32Array,
        stamp_ns: int,
        dynamic_xyxy_px: Float32Array = _NO_BOXES,
    ) -> Features:
        """Return the ORB features of the chosen corners, at subpixel positions and with depth.

        A corner that subpixel refinement would move into a box (N, 4) of a dynamic object keeps
        its integer position. The indices `chosen` ascend.
        """
        octave = corners.octave[chosen]
        angle_deg, offset_px, descriptors = _describe(
            corners.pyramid.levels, corners.xy_px[chosen], octave
        )
        uv_px = corners.uv_px.take(chosen, axis=0)
        peak_px = uv_px + offset_px * corners.pyramid.steps_px[octave]
        if len(dynamic_xyxy_px):
            entering = (_inside(peak_px, dynamic_xyxy_px) & ~_inside(uv_px, dynamic_xyxy_px)).any(
                1
            )
            peak_px[entering] = uv_px[entering]
        column, row = np.rint(peak_px).astype(np.int32).T
        reading_m = depth_m[row, column]
        return Features(
            stamp_ns=stamp_ns,
            uv_px=peak_px,
            depth_m=np.where(is_reading(reading_m), reading_m, np.float32(0)),
            octave=octave,
            angle_deg=angle_deg,
            response=corners.score[chosen].astype(np.float32),
            descriptors=descriptors,
            may_seed=np.ones(len(chosen), np.bool_),
        )


def _describe(
    levels: Sequence[ByteArray], xy_px: Int32Array, octave: ByteArray
) -> tuple[Float32Array, Float32Array, ByteArray]:
    """Return angles (N,) in degrees, subpixel offsets (N, 2) and descriptors (N, 32) of corners.

    Positions (N, 2) and offsets are in pixels of the corner's level. Octaves (N,) ascend.
    """
    x, y = np.ascontiguousarray(xy_px.T)
    angle_deg = np.empty(len(octave), np.float32)
    offset_px = np.empty((len(octave), 2), np.float32)
    descriptors = np.empty((len(octave), DESCRIPTOR_BYTES), np.uint8)
    ends = np.searchsorted(octave, np.arange(len(levels) + 1)).tolist()
    for level, first, end in zip(levels, ends, ends[1:], strict=False):
        on_level = slice(first, end)
        smooth = np.asarray(cv2.sepFilter2D(level, cv2.CV_8U, _SMOOTHING, _SMOOTHING), np.uint8)
        angle_deg[on_level] = orientations_deg(level, x[on_level], y[on_level])
        offset_px[on_level] = subpixel_offsets_px(level, x[on_level], y[on_level])
        descriptors[on_level] = orb_descriptors(
            smooth, x[on_level], y[on_level], angle_deg[on_level]
        )
    return angle_deg, offset_px, descriptors


def _inside(uv_px: FloatArray, boxes_xyxy_px: Float32Array) -> BoolArray:
    """Return (K, N) whether the pixel nearest to each position (K, 2) is in each box (N, 4)."""
    # One coordinate at a time, as `all` over an axis of length 2 takes ten times as long.
    u, v = np.rint(uv_px).T[:, :, None]
    left, top, right, bottom = boxes_xyxy_px.T
    inside: BoolArray = (u >= left) & (u < right) & (v >= top) & (v < bottom)
    return inside


def octave_budgets(num_features: int, num_levels: int, scale_factor: float) -> IntArray:
    """Return the numbers of features (L,) per level, in proportion to 1 / scale."""
    return _in_proportion(scale_factor ** -np.arange(num_levels, dtype=np.float64), num_features)


def structure_shares(counts: IntArray, pyramid: Pyramid, border_px: int) -> FloatArray:
    """Return the ratio (L,) of the corners of each level that are structure and not noise.

    Structure has at least as many corners per pixel on a coarser level: in sharp images 1 to 1.2
    times as many from each level to the next. Noise averages out on coarser levels. The density of
    structure on a level is thus at most that on any coarser level; the rest is noise, as most
    corners on fine levels of a blurred or dark image are (decision 059).
    """
    sides_px = np.array([level.shape for level in pyramid.levels]) - 2 * border_px
    has_room = sides_px.min(1) >= _MIN_SIDE_PX
    density = np.where(has_room, counts / np.maximum(sides_px.prod(1), 1), np.inf)
    structure = np.minimum.accumulate(density[::-1])[::-1]
    return np.divide(structure, density, out=np.ones(len(counts)), where=counts > 0)


def _in_proportion(weights: FloatArray, total: int) -> IntArray:
    """Return integers (L,) in proportion to weights (not all 0), with the sum `total`."""
    ends = np.round(np.cumsum(weights) / weights.sum() * total).astype(np.int64)
    return np.concatenate([ends[:1], ends[1:] - ends[:-1]])
