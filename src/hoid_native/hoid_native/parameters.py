"""Parameters of the kernels, grouped in named tuples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Pinhole(NamedTuple):
    """A pinhole camera without distortion: focal lengths and principal point in pixels."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


class StereoParams(NamedTuple):
    """A pinhole camera with a virtual right camera, and the noise of its measurements.

    A depth is expressed as the disparity u - u_right = disparity_px_m / depth_m.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    disparity_px_m: float
    # Standard deviation of a disparity: constant part in pixels, and ratio of the proportional
    # part to the disparity.
    disparity_noise_px: float
    relative_noise: float
    # Ratio of the standard deviation of u and v to the one that `inv_sigma2` states.
    pixel_noise: float = 1.0
    # True: u, v and u_right have equal noise and share one robust kernel, as in ORB-SLAM.
    joint_noise: bool = False


class Gates(NamedTuple):
    """Limits of squared normalized residuals (chi-square); observations beyond are outliers."""

    mono: float  # for observations without depth
    stereo: float  # for observations with depth


class MatchThreshold(NamedTuple):
    """Limits for the descriptor distance of a match."""

    max_distance: int  # largest Hamming distance
    # Largest ratio of the best to the second best distance; tested only if both features have the
    # same octave. 1.0: no test.
    ratio: float


class QueryConstraints(NamedTuple):
    """Octave limits and descriptors of Q queries, for which matching features are searched."""

    min_octave: NDArray[np.int8]  # (Q,) lowest octave of a matching feature
    max_octave: NDArray[np.int8]  # (Q,) highest octave of a matching feature
    descriptors: NDArray[np.uint8]  # (Q, 32) ORB descriptors


class Candidates(NamedTuple):
    """N features of an image that may be matched with queries."""

    # (N, 3) stereo observations u, v, u_right; u_right is NaN without depth. A feature whose
    # position is NaN or beyond 16384 px is not matched.
    measurement_px: NDArray[np.float32]
    octave: NDArray[np.uint8]  # (N,)
    descriptors: NDArray[np.uint8]  # (N, 32) ORB descriptors
    free: NDArray[np.bool_] | None = None  # (N,) True: the feature may be matched; None: all may
