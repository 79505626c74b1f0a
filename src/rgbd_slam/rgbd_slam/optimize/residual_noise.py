"""The noise of a camera, measured from the residuals of an adjusted map.

The configured noise holds for any depth camera and is therefore large. With weights by the
measured noise, the path around a loop is up to twice as accurate
(docs/results/places_and_loops.md, decision 003). Standard deviations are computed from medians,
because the tails are outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.bundle_problem import BundleProblem, BundleSolution

_SIGMA_PER_MEDIAN = 1.4826  # 1 / 0.6745, the median of |x| of a standard normal distribution
# Not tuned.
_MIN_OBSERVATIONS = 500  # with fewer observations, the noise is not measured
_MIN_OBSERVERS = 4  # a point with fewer observations adapts to them, and their residuals shrink
_FACTOR_RANGE = (0.1, 10.0)  # limits of the measured noise, relative to the configured


def with_residual_noise(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> tuple[StereoCamera, BundleProblem]:
    """Return the camera and the problem with the noise that the residuals of a solution show.

    The camera has the measured noise of depth, the problem that of pixels. Noise of which fewer
    than 500 observations are suitable stays as it is.
    """
    residual = _residuals_px(camera, problem, solution)
    seen = np.bincount(problem.point[~solution.outliers], minlength=problem.points_m.shape[1])
    used = ~solution.outliers & (seen[problem.point] >= _MIN_OBSERVERS)
    pixel = _factor(residual[:2] * np.sqrt(problem.inv_sigma2), used)
    disparity = problem.measured_px[0] - problem.measured_px[2]
    normalized = (residual[0] - residual[2]) / camera.disparity_sigma_px(disparity)
    depth = _factor(normalized, used & np.isfinite(disparity))
    sharper = replace(
        camera,
        disparity_noise_px=camera.disparity_noise_px * depth,
        relative_noise=camera.relative_noise * depth,
    )
    return sharper, replace(problem, inv_sigma2=problem.inv_sigma2 / pixel**2)


def _residuals_px(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> FloatArray:
    """Return the (3, M) residuals of u, v, u_right [px] of all observations.

    Those of points behind a camera have no meaning, because such observations are outliers.
    """
    T = solution.T_camera_map[problem.camera]
    x = np.einsum('mij,jm->mi', T[:, :3, :3], solution.points_m[:, problem.point]) + T[:, :3, 3]
    x[:, 2] = np.where(x[:, 2] > 0, x[:, 2], np.inf)
    return problem.measured_px - camera.project(x).T


def _factor(normalized: FloatArray, used: BoolArray) -> float:
    """Return the noise of used residuals (..., M) relative to the configured one; 1 if few."""
    if np.count_nonzero(used) < _MIN_OBSERVATIONS:
        return 1.0
    return noise_factor(normalized[..., used])


def noise_factor(normalized: FloatArray) -> float:
    """Return the standard deviation of normalized residuals (any shape), from their median."""
    sizes = np.abs(normalized).ravel()
    middle = len(sizes) // 2
    median = float(np.partition(sizes, middle)[middle])  # 3 times as fast as np.median
    low, high = _FACTOR_RANGE
    return min(max(_SIGMA_PER_MEDIAN * median, low), high)
