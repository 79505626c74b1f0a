"""Results of kernels: named tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Corners(NamedTuple):
    """N FAST corners of an image pyramid, level by level in raster order."""

    xy_px: NDArray[np.int32]  # (N, 2) pixels of the corner's own level
    uv_px: NDArray[np.float64]  # (N, 2) level-0 pixels
    pixel: NDArray[np.int64]  # (N,) flat indices of the nearest level-0 pixels
    octave: NDArray[np.uint8]  # (N,)
    score: NDArray[np.uint8]  # (N,) largest threshold at which each is still a corner


class Pairs(NamedTuple):
    """M one-to-one matches of queries and features, in order of queries."""

    q: NDArray[np.int32]  # (M,) queries
    k: NDArray[np.int32]  # (M,) features
    distance: NDArray[np.int32]  # (M,) Hamming distances of the descriptors


class Observations(NamedTuple):
    """M observations: keyframe i observes point j in its feature k."""

    i: NDArray[np.int64]  # (M,)
    k: NDArray[np.int64]  # (M,)
    j: NDArray[np.int64]  # (M,)


class Neighbors(NamedTuple):
    """N keyframes that share points with another one."""

    rows: NDArray[np.int64]  # (N,)
    shared: NDArray[np.int64]  # (N,) numbers of shared points


class Edges(NamedTuple):
    """E pairs of keyframes that share points."""

    first: NDArray[np.int64]  # (E,)
    second: NDArray[np.int64]  # (E,)
    shared: NDArray[np.int64]  # (E,) numbers of shared points


class PoseFit(NamedTuple):
    """A pose fitted to N matches."""

    T_camera_map: NDArray[np.float64]  # (4, 4)
    inliers: NDArray[np.bool_]  # (N,)
    information: NDArray[
        np.float64
    ]  # (6, 6) of the left twist, rotation first; inverse covariance


class MatchEvaluation(NamedTuple):
    """How well N matches fit a pose."""

    cost: NDArray[np.float64]  # (N,) squared errors over measured variance, truncated at the gates
    inliers: NDArray[np.bool_]  # (N,)


class BiasingRegion(NamedTuple):
    """A region of the view whose matches bias the pose of N matches."""

    mask: NDArray[np.bool_]  # (N,) matches in the region
    low: NDArray[np.float64]  # (3,) smallest x / z, y / z and log z (m) in the camera frame
    high: NDArray[np.float64]  # (3,) largest
    gain: float  # first-order cost reduction of the other matches without the region


class BundleFit(NamedTuple):
    """Adjusted poses of C cameras and P points, from M observations."""

    T_camera_map: NDArray[np.float64]  # (C, 4, 4)
    points_m: NDArray[np.float64]  # (P, 3)
    chi2: NDArray[
        np.float64
    ]  # (M,) squared normalized residuals at the end; infinite behind the camera
    cost_before: float  # Huber cost of all observations
    cost_after: float  # Huber cost of the inliers


class ClassifiedBoxes(NamedTuple):
    """Which of N boxes are dynamic, and which of K pixels are outside them."""

    depth_m: NDArray[np.float64]  # (N,) median at the center of each box; NaN = unknown
    overlap: NDArray[
        np.float64
    ]  # (N,) share covered by the person who handles it, else by any person
    gap_m: NDArray[np.float64]  # (N,) depth difference to the same person; NaN = unknown
    moves: NDArray[np.uint8]  # (N,) roles of the dynamic boxes; 0 = static
    outside: NDArray[np.int64]  # positions, among the K pixels, of those in no dynamic box
    area_px: int  # number of pixels of the whole image in no dynamic box


class Segments(NamedTuple):
    """S segments of a depth image: without depth jumps inside, no larger than a grid cell."""

    label: NDArray[np.int32]  # (H, W) segment of each pixel; -1: on a depth jump, or no reading
    region: NDArray[np.int32]  # (S,) smooth region that each belongs to
    area_px: NDArray[np.int32]  # (S,)
