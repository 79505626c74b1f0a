"""The kernels as functions over numpy arrays."""

from __future__ import annotations

from ctypes import c_double, c_int32, c_void_p
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_native.library import declare

_MAX_CORNERS_SHARE = 0.25  # of the pixels: non-maximum suppression leaves at most one of four


_fast_corners = declare(
    'hoid_fast_corners', c_void_p, *[c_int32] * 6, c_void_p, c_void_p, c_void_p
)
_orientations = declare(
    'hoid_orientations', c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_void_p
)
_match_by_projection = declare(
    'hoid_match_by_projection',
    c_int32,
    *[c_void_p] * 7,
    c_int32,
    *[c_void_p] * 4,
    c_int32,
    c_double,
    *[c_void_p] * 3,
)
_match_along_segments = declare(
    'hoid_match_along_segments',
    c_int32,
    *[c_void_p] * 5,
    c_int32,
    *[c_void_p] * 4,
    c_int32,
    c_double,
    *[c_void_p] * 3,
)


class Corners(NamedTuple):
    """FAST corners of one image, in raster order."""

    x: NDArray[np.int32]  # (N,)
    y: NDArray[np.int32]  # (N,)
    score: NDArray[np.uint8]  # (N,): the largest threshold at which each is a corner


class Pairs(NamedTuple):
    """Matches as parallel arrays (M,), in order of queries; nothing occurs twice."""

    q: NDArray[np.int32]
    k: NDArray[np.int32]
    distance: NDArray[np.int32]  # Hamming


def fast_corners(image_gray: NDArray[np.uint8], threshold: int, border_px: int) -> Corners:
    """Return the FAST-9/16 corners of an (H, W) image after 3x3 non-maximum suppression.

    Source: Rosten and Drummond, ECCV 2006; the same corners and scores as OpenCV's.
    """
    image = _rows_contiguous(image_gray)
    height, width = image.shape
    if min(height, width) < 2 * max(border_px, 3) + 32:  # a block of 32 pixels must fit
        return Corners(np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.uint8))
    capacity = int(height * width * _MAX_CORNERS_SHARE)
    x, y = np.empty((2, capacity), np.int32)
    score = np.empty(capacity, np.uint8)
    n = _fast_corners(
        image.ctypes.data,
        width,
        height,
        image.strides[0],
        threshold,
        border_px,
        capacity,
        x.ctypes.data,
        y.ctypes.data,
        score.ctypes.data,
    )
    return Corners(x[:n].copy(), y[:n].copy(), score[:n].copy())


def orientations_deg(
    image_gray: NDArray[np.uint8], x: NDArray[np.int32], y: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the (N,) intensity-centroid angles in [0, 360) of pixels >= 15 px from the edge.

    Source: Rublee et al., ORB, ICCV 2011, sec. 3.2.
    """
    image = _rows_contiguous(image_gray)
    x, y = np.ascontiguousarray(x, np.int32), np.ascontiguousarray(y, np.int32)
    height, width = image.shape
    if len(x) and (min(x.min(), y.min()) < 15 or x.max() >= width - 15 or y.max() >= height - 15):
        raise ValueError('orientations_deg: pixels must be at least 15 px from the edge')
    out = np.empty(len(x), np.float32)
    _orientations(
        image.ctypes.data,
        image.strides[0],
        len(x),
        x.ctypes.data,
        y.ctypes.data,
        out.ctypes.data,
    )
    return out


def match_by_projection(
    projection_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    min_octave: NDArray[np.int8],
    max_octave: NDArray[np.int8],
    query_descriptors: NDArray[np.uint8],
    measurement_px: NDArray[np.float32],
    octave: NDArray[np.uint8],
    descriptors: NDArray[np.uint8],
    free: NDArray[np.bool_] | None,
    max_distance: int,
    ratio: float,
) -> Pairs:
    """Return the best feature of each query near its expected pixel, one to one.

    Args:
        projection_px: (3, Q) u, v, u_right where each query is expected; NaN u_right: unknown.
        radius_px: (Q,) half sides of the square windows.
        min_octave: (Q,) inclusive.
        max_octave: (Q,) inclusive.
        query_descriptors: (Q, 32).
        measurement_px: (N, 3) u, v, u_right of the features; NaN u_right: no depth.
        octave: (N,).
        descriptors: (N, 32).
        free: (N,) features that may be matched; None for all.
        max_distance: largest Hamming distance of a match.
        ratio: a best candidate must beat a second best of its octave by this; 1.0: no test.

    """
    num_queries, num_features = len(radius_px), len(octave)
    u, v, u_right = np.ascontiguousarray(projection_px, np.float64)
    radius = np.ascontiguousarray(radius_px, np.float64)
    low, high = (
        np.ascontiguousarray(min_octave, np.int8),
        np.ascontiguousarray(max_octave, np.int8),
    )
    wanted = np.ascontiguousarray(query_descriptors)
    measured = np.ascontiguousarray(measurement_px, np.float32)
    levels, known = np.ascontiguousarray(octave, np.uint8), np.ascontiguousarray(descriptors)
    may = None if free is None else np.ascontiguousarray(free)
    out = np.empty((3, num_queries), np.int32)
    n = _match_by_projection(
        num_queries,
        u.ctypes.data,
        v.ctypes.data,
        u_right.ctypes.data,
        radius.ctypes.data,
        low.ctypes.data,
        high.ctypes.data,
        wanted.ctypes.data,
        num_features,
        measured.ctypes.data,
        levels.ctypes.data,
        known.ctypes.data,
        None if may is None else may.ctypes.data,
        max_distance,
        ratio,
        *(row.ctypes.data for row in out),
    )
    return Pairs(*(row[:n] for row in out))


def match_along_segments(
    segments_px: NDArray[np.float64],
    octave_radius_px: NDArray[np.float64],
    min_octave: NDArray[np.int8],
    max_octave: NDArray[np.int8],
    query_descriptors: NDArray[np.uint8],
    measurement_px: NDArray[np.float32],
    octave: NDArray[np.uint8],
    descriptors: NDArray[np.uint8],
    free: NDArray[np.bool_] | None,
    max_distance: int,
    ratio: float,
) -> Pairs:
    """Return the best feature of each query along the segment where it may be, one to one.

    Args:
        segments_px: (Q, 4) u, v of both ends.
        octave_radius_px: (L,) how far from the segment a feature of each octave may lie.
        min_octave: (Q,) inclusive.
        max_octave: (Q,) inclusive, below L.
        query_descriptors: (Q, 32).
        measurement_px: (N, 3) u, v, u_right of the features; the last is not looked at.
        octave: (N,), below L.
        descriptors: (N, 32).
        free: (N,) features that may be matched; None for all.
        max_distance: largest Hamming distance of a match.
        ratio: a best candidate must beat a second best of its octave by this; 1.0: no test.

    """
    num_queries, num_features = len(segments_px), len(octave)
    segments = np.ascontiguousarray(segments_px, np.float64)
    radius = np.ascontiguousarray(octave_radius_px, np.float64)
    low, high = (
        np.ascontiguousarray(min_octave, np.int8),
        np.ascontiguousarray(max_octave, np.int8),
    )
    wanted = np.ascontiguousarray(query_descriptors)
    measured = np.ascontiguousarray(measurement_px, np.float32)
    levels, known = np.ascontiguousarray(octave, np.uint8), np.ascontiguousarray(descriptors)
    may = None if free is None else np.ascontiguousarray(free)
    out = np.empty((3, num_queries), np.int32)
    n = _match_along_segments(
        num_queries,
        segments.ctypes.data,
        radius.ctypes.data,
        low.ctypes.data,
        high.ctypes.data,
        wanted.ctypes.data,
        num_features,
        measured.ctypes.data,
        levels.ctypes.data,
        known.ctypes.data,
        None if may is None else may.ctypes.data,
        max_distance,
        ratio,
        *(row.ctypes.data for row in out),
    )
    return Pairs(*(row[:n] for row in out))


def _rows_contiguous(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return image if image.strides[1] == 1 else np.ascontiguousarray(image)
