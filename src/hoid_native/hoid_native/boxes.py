"""Boxes: how much of them lies in others, what moves, and which pixels lie outside of that."""

from __future__ import annotations

import math
from ctypes import c_double, c_int32, c_void_p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

PERSON, MAY_BE_HANDLED = 1, 2
"""Roles of boxes."""

_PAIRS = (c_int32, c_void_p, c_int32, c_void_p, c_void_p)
_overlap_ratios = declare('hoid_overlap_ratios', *_PAIRS)
_intersections_over_union = declare('hoid_intersections_over_union', *_PAIRS)
_are_boxes_fit = declare('hoid_are_boxes_fit', *[c_int32] * 3, *[c_void_p] * 2)
_judge_boxes = declare(
    'hoid_judge_boxes',
    c_void_p,
    *[c_int32] * 3,
    *[c_void_p] * 2,
    c_int32,
    *[c_double] * 3,
    c_int32,
    *[c_void_p] * 5,
)


def overlap_ratios(
    boxes_xyxy_px: NDArray[Any], others_xyxy_px: NDArray[Any]
) -> NDArray[np.float64]:
    """Return the (N, M) shares of each box's own area that lie in each of the others.

    In [0, 1]; 0 for a box without area. This is the interaction area of the HOID paper.

    Args:
        boxes_xyxy_px: (N, 4), finite.
        others_xyxy_px: (M, 4), finite.

    """
    return _of_pairs(_overlap_ratios, boxes_xyxy_px, others_xyxy_px)


def intersections_over_union(
    boxes_xyxy_px: NDArray[Any], others_xyxy_px: NDArray[Any]
) -> NDArray[np.float64]:
    """Return the (N, M) ratios in [0, 1] of shared area to joint area; see `overlap_ratios`."""
    return _of_pairs(_intersections_over_union, boxes_xyxy_px, others_xyxy_px)


def _of_pairs(
    kernel: Any, boxes_xyxy_px: NDArray[Any], others_xyxy_px: NDArray[Any]
) -> NDArray[np.float64]:
    n, m = len(boxes_xyxy_px), len(others_xyxy_px)
    boxes = contiguous(boxes_xyxy_px, np.float64, n, 4)
    others = contiguous(others_xyxy_px, np.float64, m, 4)
    out = np.empty((n, m))
    kernel(n, address(boxes), m, address(others), address(out))
    return out


def are_boxes_fit(
    boxes_xyxy_px: NDArray[np.float32], scores: NDArray[np.float32], shape_hw: tuple[int, int]
) -> bool:
    """Return whether (N, 4) boxes have areas inside the image and (N,) scores are in [0, 1]."""
    n = len(boxes_xyxy_px)
    boxes, values = contiguous(boxes_xyxy_px, np.float32, n, 4), contiguous(scores, np.float32, n)
    height, width = shape_hw
    return bool(_are_boxes_fit(width, height, n, address(boxes), address(values)))


class Judged(NamedTuple):
    """What is said of N boxes, and of K pixels."""

    depth_m: NDArray[np.float64]  # (N,) as of `sample_depths_m`
    overlap: NDArray[np.float64]  # (N,) with the person who handles it and covers most of it
    gap_m: NDArray[np.float64]  # (N,) in depth to the same; NaN = unknown
    moves: NDArray[np.uint8]  # (N,) roles of those that move; 0 = static
    outside: NDArray[
        np.int64
    ]  # of the K pixels, ascending, those with their centre in no moving box
    area_px: int  # how many pixels of the whole image are outside


def judge_boxes(
    depth_m: NDArray[np.float32],
    pixels: NDArray[np.int64],
    boxes_xyxy_px: NDArray[Any],
    roles: NDArray[np.uint8],
    side_px: int,
    min_share: float,
    apart_m: float,
    reach_px: float = math.nan,
) -> Judged:
    """Return which of N boxes move, people and what people handle, and what lies outside them.

    Args:
        depth_m: (H, W), not empty; 0 or NaN = no reading.
        pixels: (K,) indices in the flat image.
        boxes_xyxy_px: (N, 4), finite.
        roles: (N,): `PERSON`, `MAY_BE_HANDLED` or 0.
        side_px: as of `sample_depths_m`.
        min_share: a person handles a box when covering more than this share of it ...
        apart_m: ... and nearer than this in depth; a depth that is not known is near.
        reach_px: instead of the share, where given: a pixel in the box has a part of the person's
            within this reach along rows and columns.

    """
    (height, width), n, k = depth_m.shape, len(boxes_xyxy_px), len(pixels)
    depth, flat = contiguous(depth_m, np.float32), contiguous(pixels, np.int64, k)
    boxes, parts = contiguous(boxes_xyxy_px, np.float64, n, 4), contiguous(roles, np.uint8, n)
    out, moves = np.empty((3, n)), np.empty(n, np.uint8)
    outside, area_px = np.empty(k, np.int64), np.empty(1, np.int64)
    num = _judge_boxes(
        address(depth),
        width,
        height,
        n,
        address(boxes),
        address(parts),
        side_px,
        min_share,
        apart_m,
        reach_px,
        k,
        address(flat),
        address(out),
        address(moves),
        address(outside),
        address(area_px),
    )
    return Judged(out[0], out[1], out[2], moves, outside[:num], int(area_px[0]))
