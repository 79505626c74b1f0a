"""Boxes: how much of them lies in others, and which pixels lie in them."""

from __future__ import annotations

from ctypes import c_double, c_int32, c_void_p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_native.library import declare

PERSON, MAY_BE_HANDLED = 1, 2
"""Roles of boxes."""

_PAIRS = (c_int32, c_void_p, c_int32, c_void_p, c_void_p)
_overlap_ratios = declare('hoid_overlap_ratios', *_PAIRS)
_intersections_over_union = declare('hoid_intersections_over_union', *_PAIRS)
_judge_boxes = declare(
    'hoid_judge_boxes',
    c_void_p,
    *[c_int32] * 3,
    *[c_void_p] * 2,
    c_int32,
    *[c_double] * 2,
    *[c_void_p] * 2,
)
_cells_of = declare('hoid_cells_of', c_int32, *[c_void_p] * 2, c_int32, *[c_void_p] * 2)
_outside_boxes = declare('hoid_outside_boxes', *[c_int32] * 3, c_void_p, c_int32, *[c_void_p] * 3)
_boxes_holding = declare(
    'hoid_boxes_holding', *[c_int32] * 3, c_void_p, c_int32, c_void_p, c_void_p
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
    boxes = np.ascontiguousarray(boxes_xyxy_px, np.float64)
    others = np.ascontiguousarray(others_xyxy_px, np.float64)
    out = np.empty((len(boxes), len(others)))
    kernel(len(boxes), boxes.ctypes.data, len(others), others.ctypes.data, out.ctypes.data)
    return out


class Judged(NamedTuple):
    """What is said of N boxes."""

    depth_m: NDArray[np.float64]  # (N,) as of `sample_depths_m`
    overlap: NDArray[np.float64]  # (N,) with the person who handles it and covers most of it
    gap_m: NDArray[np.float64]  # (N,) in depth to the same; NaN = unknown
    moves: NDArray[np.bool_]  # (N,)


def judge_boxes(
    depth_m: NDArray[np.float32],
    boxes_xyxy_px: NDArray[Any],
    roles: NDArray[np.uint8],
    side_px: int,
    min_share: float,
    apart_m: float,
    touches: NDArray[np.bool_] | None = None,
) -> Judged:
    """Return which of N boxes move: people, and what people handle.

    Args:
        depth_m: (H, W), not empty; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite.
        roles: (N,): `PERSON`, `MAY_BE_HANDLED` or 0.
        side_px: as of `sample_depths_m`.
        min_share: a person handles a box when covering more than this share of it ...
        apart_m: ... and nearer than this in depth; a depth that is not known is near.
        touches: (N, M) for M people, instead of `min_share`.

    """
    depth = np.ascontiguousarray(depth_m, np.float32)
    boxes = np.ascontiguousarray(boxes_xyxy_px, np.float64)
    height, width = depth.shape
    out = np.empty((4, len(boxes)))
    _judge_boxes(
        depth.ctypes.data,
        width,
        height,
        len(boxes),
        boxes.ctypes.data,
        roles.ctypes.data,
        side_px,
        min_share,
        apart_m,
        None if touches is None else touches.ctypes.data,
        out.ctypes.data,
    )
    return Judged(out[0], out[1], out[2], out[3] > 0)


def outside_boxes(
    pixels: NDArray[np.int64], boxes_xyxy_px: NDArray[Any], shape_hw: tuple[int, int]
) -> tuple[NDArray[np.int64], int]:
    """Return which of K pixels have their centre in no box, and how many of the image do so.

    Args:
        pixels: (K,) indices in the flat image.
        boxes_xyxy_px: (N, 4), finite.
        shape_hw: of the image.

    Returns:
        Indices into the K pixels, ascending, and the number of pixels in the whole image.

    """
    boxes = np.ascontiguousarray(boxes_xyxy_px, np.float64)
    flat = np.ascontiguousarray(pixels, np.int64)
    height, width = shape_hw
    out = np.empty(len(flat) + 1, np.int64)  # the last one is the area
    num = _outside_boxes(
        width,
        height,
        len(boxes),
        boxes.ctypes.data,
        len(flat),
        flat.ctypes.data,
        out.ctypes.data,
        out.ctypes.data + len(flat) * out.itemsize,
    )
    return out[:num], int(out[-1])


def boxes_holding(
    pixels: NDArray[np.int64], boxes_xyxy_px: NDArray[Any], shape_hw: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return the (N,) boxes in which the centre of one of the pixels lies; see `outside_boxes`."""
    boxes = np.ascontiguousarray(boxes_xyxy_px, np.float64)
    flat = np.ascontiguousarray(pixels, np.int64)
    height, width = shape_hw
    out = np.empty(len(boxes), np.bool_)
    _boxes_holding(
        width, height, len(boxes), boxes.ctypes.data, len(flat), flat.ctypes.data, out.ctypes.data
    )
    return out


def cells_of(
    pixels: NDArray[np.int64], rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return rows[v] + columns[u] for each (u, v) of K pixels.

    Args:
        pixels: (K,) indices in the flat (H, W) image.
        rows: (H,).
        columns: (W,).

    """
    flat = np.ascontiguousarray(pixels, np.int64)
    out = np.empty(len(flat), np.int64)
    _cells_of(
        len(columns),
        rows.ctypes.data,
        columns.ctypes.data,
        len(flat),
        flat.ctypes.data,
        out.ctypes.data,
    )
    return out
