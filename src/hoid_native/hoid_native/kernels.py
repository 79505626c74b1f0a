"""The kernels as functions over numpy arrays."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double, c_int32, c_void_p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

_MAX_CORNERS_SHARE = 0.25  # of the pixels: non-maximum suppression leaves at most one of four
_DESCRIPTOR_BYTES = 32

_fast_corners = declare(
    'hoid_fast_corners', c_void_p, *[c_int32] * 6, c_void_p, c_void_p, c_void_p
)
_orientations = declare(
    'hoid_orientations', c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_void_p
)
_corner_peaks = declare('hoid_corner_peaks', c_void_p, c_int32, c_int32, *[c_void_p] * 3)
_orb_descriptors = declare('hoid_orb_descriptors', c_void_p, c_int32, c_int32, *[c_void_p] * 4)
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
    height, width = image_gray.shape
    if min(height, width) < 2 * max(border_px, 3) + 32:  # a block of 32 pixels must fit
        return Corners(np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.uint8))
    image = contiguous(image_gray, np.uint8)
    capacity = int(height * width * _MAX_CORNERS_SHARE)
    x, y = np.empty((2, capacity), np.int32)
    score = np.empty(capacity, np.uint8)
    n = _fast_corners(
        address(image),
        width,
        height,
        image.strides[0],
        threshold,
        border_px,
        capacity,
        address(x),
        address(y),
        address(score),
    )
    return Corners(x[:n].copy(), y[:n].copy(), score[:n].copy())


def corner_peaks_px(
    image_gray: NDArray[np.uint8], x: NDArray[np.int32], y: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the (N, 2) offsets from FAST corners to where their score peaks between the pixels.

    The peak is that of the quadratic that fits the signed scores of a corner's pixel and its eight
    neighbours best, no further than the edge of the pixel: within [-0.5, 0.5] in x and in y, and 0
    where the quadratic has none. Pixels must be at least 4 px from the edge.
    """
    out = np.empty((len(x), 2), np.float32)
    _measure(_corner_peaks, image_gray, x, y, 4, out)
    return out


def orientations_deg(
    image_gray: NDArray[np.uint8], x: NDArray[np.int32], y: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the (N,) intensity-centroid angles in [0, 360) of pixels >= 15 px from the edge.

    Source: Rublee et al., ORB, ICCV 2011, sec. 3.2.
    """
    out = np.empty(len(x), np.float32)
    _measure(_orientations, image_gray, x, y, 15, out)
    return out


def orb_descriptors(
    image_smooth: NDArray[np.uint8],
    x: NDArray[np.int32],
    y: NDArray[np.int32],
    angle_deg: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """Return the (N, 32) descriptors of pixels >= 19 px from the edge, turned by their angles.

    Source: Rublee et al., ORB, ICCV 2011, sec. 4; the same bits as OpenCV's.
    """
    out = np.empty((len(x), _DESCRIPTOR_BYTES), np.uint8)
    _measure(
        _orb_descriptors, image_smooth, x, y, 19, contiguous(angle_deg, np.float32, len(x)), out
    )
    return out


def _measure(
    kernel: Callable[..., Any],
    image_gray: NDArray[np.uint8],
    x: NDArray[np.int32],
    y: NDArray[np.int32],
    border_px: int,
    *more: NDArray[Any],
) -> None:
    """Let a kernel write what it measures around each of N pixels into the last of the arrays."""
    height, width = image_gray.shape
    n, b = len(x), border_px
    if n and (min(x.min(), y.min()) < b or x.max() >= width - b or y.max() >= height - b):
        raise ValueError(f'pixels must be at least {border_px} px from the edge')
    image = contiguous(image_gray, np.uint8)
    arrays = contiguous(x, np.int32, n), contiguous(y, np.int32, n), *more
    kernel(address(image), image.strides[0], n, *map(address, arrays))


class Wanted(NamedTuple):
    """What Q queries ask of a feature, wherever it lies."""

    min_octave: NDArray[np.int8]  # (Q,) inclusive
    max_octave: NDArray[np.int8]  # (Q,) inclusive
    descriptors: NDArray[np.uint8]  # (Q, 32)


class Candidates(NamedTuple):
    """N features among which queries look for theirs."""

    measurement_px: NDArray[np.float32]  # (N, 3) u, v, u_right; NaN u_right: no depth
    octave: NDArray[np.uint8]  # (N,)
    descriptors: NDArray[np.uint8]  # (N, 32)
    free: NDArray[np.bool_] | None = None  # (N,) those that may be matched; None: all


class Bar(NamedTuple):
    """How good a match must be."""

    max_distance: int  # Hamming
    ratio: float  # by which the best must beat a second best of its octave; 1.0: no test


def match_by_projection(
    projection_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    wanted: Wanted,
    candidates: Candidates,
    bar: Bar,
) -> Pairs:
    """Return the best feature of each query near its expected pixel, one to one.

    Args:
        projection_px: (3, Q) u, v, u_right where each query is expected; NaN u_right: unknown.
        radius_px: (Q,) half sides of the square windows.
        wanted: by each query.
        candidates: which agree in u_right too where both know it.
        bar: for a match.

    """
    q = len(wanted.descriptors)
    places = *contiguous(projection_px, np.float64, 3, q), contiguous(radius_px, np.float64, q)
    return _match(_match_by_projection, places, wanted, candidates, bar)


def match_along_segments(
    segments_px: NDArray[np.float64],
    octave_radius_px: NDArray[np.float64],
    wanted: Wanted,
    candidates: Candidates,
    bar: Bar,
) -> Pairs:
    """Return the best feature of each query along the segment where it may be, one to one.

    Args:
        segments_px: (Q, 4) u, v of both ends.
        octave_radius_px: (L,) how far from the segment a feature of each octave may lie; all
            octaves are below L.
        wanted: by each query.
        candidates: whose u_right is not looked at.
        bar: for a match.

    """
    places = (
        contiguous(segments_px, np.float64, len(wanted.descriptors), 4),
        contiguous(octave_radius_px, np.float64),
    )
    return _match(_match_along_segments, places, wanted, candidates, bar)


def _match(
    kernel: Any,
    places: tuple[NDArray[np.float64], ...],
    wanted: Wanted,
    candidates: Candidates,
    bar: Bar,
) -> Pairs:
    q, n = len(wanted.descriptors), len(candidates.octave)
    queries = (
        contiguous(wanted.min_octave, np.int8, q),
        contiguous(wanted.max_octave, np.int8, q),
        contiguous(wanted.descriptors, np.uint8, q, _DESCRIPTOR_BYTES),
    )
    features = (
        contiguous(candidates.measurement_px, np.float32, n, 3),
        contiguous(candidates.octave, np.uint8, n),
        contiguous(candidates.descriptors, np.uint8, n, _DESCRIPTOR_BYTES),
    )
    free = None if candidates.free is None else contiguous(candidates.free, np.bool_, n)
    out = np.empty((3, q), np.int32)
    num = kernel(
        q,
        *map(address, (*places, *queries)),
        n,
        *map(address, features),
        None if free is None else address(free),
        *bar,
        *map(address, out),
    )
    return Pairs(*out[:, :num])
