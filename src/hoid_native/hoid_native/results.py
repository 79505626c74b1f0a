"""What kernels return, as named tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Corners(NamedTuple):
    """FAST corners of a pyramid's levels, level by level in raster order."""

    xy_px: NDArray[np.int32]  # (N, 2) pixels of their own level
    uv_px: NDArray[np.float64]  # (N, 2) level-0 pixels
    pixel: NDArray[np.int64]  # (N,) indices of the nearest level-0 pixels in the flat image
    octave: NDArray[np.uint8]  # (N,)
    score: NDArray[np.uint8]  # (N,): the largest threshold at which each is a corner


class Followed(NamedTuple):
    """Where N points of one image are in another."""

    uv_px: NDArray[np.float32]  # (N, 2); of those not found, where the search ended
    found: NDArray[np.bool_]  # (N,)


class Pairs(NamedTuple):
    """Matches as parallel arrays (M,), in order of queries; nothing occurs twice."""

    q: NDArray[np.int32]
    k: NDArray[np.int32]
    distance: NDArray[np.int32]  # Hamming


class PoseFit(NamedTuple):
    """A pose and what supports it."""

    T_camera_map: NDArray[np.float64]  # (4, 4)
    inliers: NDArray[np.bool_]  # (N,)
    information: NDArray[np.float64]  # (6, 6) of the left twist, rotation first


class MatchJudgement(NamedTuple):
    """How well matches fit a pose."""

    cost: NDArray[np.float64]  # (N,) squared errors at the measured noise, cut off at the gates
    inliers: NDArray[np.bool_]  # (N,)


class MovingPart(NamedTuple):
    """Matches in one place, and what it would mean to leave them out."""

    mask: NDArray[np.bool_]  # (N,)
    low: NDArray[np.float64]  # (3,) the least x / z, y / z and log z of them in the camera
    high: NDArray[np.float64]  # (3,) and the largest
    gain: float  # by how much the cost of the rest would fall, to first order


class BundleFit(NamedTuple):
    """Adjusted poses and points."""

    T_camera_map: NDArray[np.float64]  # (C, 4, 4)
    points_m: NDArray[np.float64]  # (P, 3)
    chi2: NDArray[np.float64]  # (M,) at the end; infinite behind a camera
    cost_before: float
    cost_after: float


class Judged(NamedTuple):
    """What is said of N boxes, and of K pixels."""

    depth_m: NDArray[np.float64]  # (N,) as of `sample_depths_m`
    overlap: NDArray[np.float64]  # (N,) with the person who handles it and covers most of it
    gap_m: NDArray[np.float64]  # (N,) in depth to the same; NaN = unknown
    moves: NDArray[np.uint8]  # (N,) roles of those that move; 0 = static
    outside: NDArray[np.int64]  # of the K pixels, those with their centre in no moving box
    area_px: int  # how many pixels of the whole image are outside


class Segments(NamedTuple):
    """Pieces of a depth image without jumps, no larger than a cell."""

    label: NDArray[np.int32]  # (H, W) of each pixel; -1: on a jump of depth, or no reading
    region: NDArray[np.int32]  # (S,) the smooth region that each is a piece of
    area_px: NDArray[np.int32]  # (S,)
