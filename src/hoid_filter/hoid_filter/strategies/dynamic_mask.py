"""The low-resolution mask of dynamic pixels, and the corners that lie outside this mask."""

from __future__ import annotations

import functools
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray, ObjectState
from hoid_filter.config import PlusConfig
from hoid_filter.extraction.pyramid import Int32Array
from hoid_filter.strategies.interaction import TrackSnapshot
from hoid_filter.strategy import FilterInput, ObjectVerdicts, Verdict
from hoid_native import segment_objects

STRIDE_PX = 4
"""Pixels per low-resolution pixel. Chosen: a mask of VGA, 160x120, takes a 16th of the time."""
_SAMPLED = np.s_[STRIDE_PX // 2 :: STRIDE_PX, STRIDE_PX // 2 :: STRIDE_PX]
# Chosen: a static corner nearer to a moving object is dropped too, because much of its descriptor
# patch, of radius 15 px in octave 0, shows the object.
_MARGIN_PX = 8
_MARGIN_KERNEL = np.ones((2 * round(_MARGIN_PX / STRIDE_PX) + 1,) * 2, np.uint8)
# Chosen: the predicted box of a missed object is enlarged on each side by this ratio of its width
# and height, because the prediction may be off by as much.
_PREDICTION_MARGIN = 0.1


def subsample(depth_m: Float32Array) -> Float32Array:
    """Return every fourth pixel of every fourth row of depth (H, W), from row and column 2 on."""
    return np.ascontiguousarray(depth_m[_SAMPLED])


@functools.cache
def subsampled_pixels(shape_hw: tuple[int, ...]) -> IntArray:
    """Return the (h, w) flat indices, in an (H, W) image, of the pixels that `subsample` takes."""
    return np.arange(shape_hw[0] * shape_hw[1]).reshape(shape_hw)[_SAMPLED]


def _subsampled_boxes(boxes_xyxy_px: FloatArray, shape_hw: tuple[int, ...]) -> Int32Array:
    """Return the smallest boxes (N, 4) in low-resolution pixels that cover boxes, clipped."""
    height, width = shape_hw
    covering = boxes_xyxy_px / STRIDE_PX
    covering[:, :2] = np.floor(covering[:, :2])
    covering[:, 2:] = np.minimum(np.ceil(covering[:, 2:]), (width, height))
    return np.maximum(covering, 0).astype(np.int32)


def masked(
    is_dynamic: BoolArray,
    image: FilterInput,
    objects: ObjectVerdicts,
    detected_mask: BoolArray | None = None,
) -> Verdict:
    """Return the verdict that masks dynamic pixels (h, w) and a margin of 8 px around them."""
    size_px = image.depth_m.size
    if not is_dynamic.any():
        return Verdict(objects, size_px, None, is_dynamic, detected_mask)
    dilated = cv2.dilate(is_dynamic.view(np.uint8), _MARGIN_KERNEL)
    grid = _upsampling(image.depth_m.shape, dilated.shape)
    is_dynamic = dilated > 0
    is_masked = is_dynamic.take(grid.cell_of_pixel.take(image.corner_pixels))
    static_area_px = size_px - int(grid.areas_px[is_dynamic].sum())
    kept = np.flatnonzero(~is_masked)
    return Verdict(objects, static_area_px, kept, is_dynamic, detected_mask)


class _Upsampling(NamedTuple):
    """The low-resolution cell to which each full-resolution pixel belongs."""

    cell_of_pixel: Int32Array  # (H * W,) flat index of the cell of each pixel
    areas_px: Int32Array  # (h, w) number of full-resolution pixels in each cell


@functools.cache
def _upsampling(size_hw: tuple[int, int], low_hw: tuple[int, int]) -> _Upsampling:
    rows, columns = (_nearest(*sizes) for sizes in zip(size_hw, low_hw, strict=True))
    areas_px = np.outer(np.bincount(rows), np.bincount(columns)).astype(np.int32)
    cell_of_pixel = np.add.outer(rows * low_hw[1], columns).astype(np.int32)
    return _Upsampling(cell_of_pixel.ravel(), areas_px)


def _nearest(size: int, low_size: int) -> IntArray:
    """Return the index (size,) of the low-resolution pixel that OpenCV assigns to each pixel."""
    row = np.arange(low_size, dtype=np.float32)[None]
    enlarged = cv2.resize(row, (size, 1), interpolation=cv2.INTER_NEAREST)
    return np.asarray(enlarged[0], np.int64)


def mask_objects(
    snapshot: TrackSnapshot,
    reasons: tuple[ObjectState, ...],
    low_depth_m: Float32Array,
    plus: PlusConfig,
) -> BoolArray:
    """Return the mask (h, w) of the dynamic objects, without margin.

    In each box, only the surface near the object's depth is masked. The whole box is masked if
    that depth is unknown, or with `keep_background` off. The box is enlarged if the newest
    detections do not contain the object. Boxes that are predicted because the detector skipped the
    image count as certain as in the previous image (decision 056).
    """
    dynamic = [n for n, reason in enumerate(reasons) if reason is not ObjectState.AT_REST]
    if not dynamic:
        return np.zeros(low_depth_m.shape, np.bool_)
    is_seen = np.array([not snapshot.tracks[n].is_missed for n in dynamic], np.bool_)
    is_person = [snapshot.tracks[n].is_person for n in dynamic]
    boxes = snapshot.boxes_xyxy_px[dynamic]
    margin = _PREDICTION_MARGIN * (boxes[:, 2:] - boxes[:, :2]) * ~is_seen[:, None]
    boxes[:, :2] -= margin
    boxes[:, 2:] += margin
    return segment_objects(
        low_depth_m,
        _subsampled_boxes(boxes, low_depth_m.shape),
        snapshot.depths_m[dynamic] if plus.keep_background else np.full(len(dynamic), np.nan),
        np.where(is_person, plus.person_depth_m, plus.object_depth_m),
        is_seen,
    )
