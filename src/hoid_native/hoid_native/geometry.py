"""Least squares on pixels and disparities: the pose of one image, or poses and points.

Pixels and the disparity u - u_right are independent measurements with robust kernels of their own;
outliers are told on (u, v, u_right) (Mur-Artal and Tardos, T-RO 2017).
"""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int32, c_void_p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

_optimize_pose = declare('hoid_optimize_pose', c_void_p, c_void_p, c_int32, *[c_void_p] * 6)
_adjust_bundle = declare(
    'hoid_adjust_bundle',
    c_void_p,
    c_void_p,
    *[c_int32] * 4,
    *[c_void_p] * 4,
    c_int32,
    c_int32,
    *[c_void_p] * 4,
)


class Lens(NamedTuple):
    """A pinhole camera with a virtual right column: u_right = u - disparity_px_m / depth_m."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    disparity_px_m: float
    disparity_noise_px: float  # standard deviation of measured disparities: a constant part,
    relative_noise: float  # and a part that grows with the disparity
    pixel_noise: float = 1.0  # standard deviation of pixels, in units of that of their weights
    joint_noise: bool = False  # u_right is as noisy as u and v, all under one kernel


class Gates(NamedTuple):
    """Squared normalised residuals beyond which an observation is an outlier."""

    mono: float  # without depth
    stereo: float


class PoseFit(NamedTuple):
    """A pose and what supports it."""

    T_camera_map: NDArray[np.float64]  # (4, 4)
    inliers: NDArray[np.bool_]  # (N,)
    information: NDArray[np.float64]  # (6, 6) of the left twist, rotation first


class BundleFit(NamedTuple):
    """Adjusted poses and points."""

    T_camera_map: NDArray[np.float64]  # (C, 4, 4)
    points_m: NDArray[np.float64]  # (P, 3)
    chi2: NDArray[np.float64]  # (M,) at the end; infinite behind a camera
    cost_before: float
    cost_after: float


def optimize_pose(
    lens: Lens,
    gates: Gates,
    points_m: NDArray[np.float64],
    measured_px: NDArray[np.float64],
    inv_sigma2: NDArray[np.float64],
    T_camera_map: NDArray[np.float64],
) -> PoseFit:
    """Return the pose that explains matches best: Gauss-Newton with a Huber kernel.

    Args:
        lens: Of the image.
        gates: Of outliers, told anew after each of three rounds, and of the kernel.
        points_m: (N, 3) in the map's frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4) where to start.

    """
    n = len(inv_sigma2)
    matches = (
        contiguous(points_m, np.float64, n, 3),
        contiguous(measured_px, np.float64, n, 3),
        contiguous(inv_sigma2, np.float64, n),
    )
    T = np.array(T_camera_map, np.float64, order='C')
    inliers, information = np.empty(n, np.bool_), np.empty((6, 6))
    changed = T, inliers, information
    _optimize_pose(*_numbers(lens, gates), n, *map(address, matches + changed))
    return PoseFit(T, inliers, information)


def adjust_bundle(
    lens: Lens,
    gates: Gates,
    T_camera_map: NDArray[np.float64],
    num_free: int,
    points_m: NDArray[np.float64],
    camera: NDArray[np.int64],
    point: NDArray[np.int64],
    measured_px: NDArray[np.float64],
    inv_sigma2: NDArray[np.float64],
    rounds: int,
    iterations: int,
) -> BundleFit:
    """Adjust with a Huber kernel, in rounds after each of which what does not fit is left out.

    Args:
        lens: Of all images.
        gates: Of outliers, and of the kernel.
        T_camera_map: (C, 4, 4), the first `num_free` are moved.
        num_free: How many cameras move.
        points_m: (P, 3).
        camera: (M,) which camera observes.
        point: (M,) which point; once a camera at most.
        measured_px: (M, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (M,) 1 / variance of each coordinate [1/px^2].
        rounds: How many, at least one.
        iterations: Of each round, at most.

    """
    order = np.argsort(point, kind='stable')
    num_points, m = len(points_m), len(order)
    T, points = (np.array(part, np.float64, order='C') for part in (T_camera_map, points_m))
    observations = (
        contiguous(camera[order], np.int32, m),
        contiguous(point[order], np.int32, m),
        contiguous(measured_px[order], np.float64, m, 3),
        contiguous(inv_sigma2[order], np.float64, m),
    )
    chi2, costs = np.empty(m), np.empty(2)
    _adjust_bundle(
        *_numbers(lens, gates),
        len(T),
        num_free,
        num_points,
        m,
        *map(address, observations),
        rounds,
        iterations,
        *map(address, (T, points, chi2, costs)),
    )
    out = np.empty(m)
    out[order] = chi2
    return BundleFit(T, points, out, float(costs[0]), float(costs[1]))


def _numbers(lens: Lens, gates: Gates) -> Iterator[Any]:
    return (address(np.array(values, np.float64)) for values in (lens, gates))
