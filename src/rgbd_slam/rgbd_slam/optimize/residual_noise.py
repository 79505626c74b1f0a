"""How noisy a camera is, told from how well its own map fits.

The configured noise suits any depth camera and is therefore cautious. Over a whole map there are
enough residuals to measure it instead, and with the measured weights the long way round a loop is
up to twice as accurate (docs/results/places_and_loops.md). Medians are used, as the tails are
outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.bundle_problem import BundleProblem, BundleSolution

_SIGMA_PER_MEDIAN = 1.4826  # of the absolute values of a normal distribution
_MIN_OBSERVATIONS = 500
_MIN_SEEN = 4  # a point seen less often bends to its observations
_FACTORS = (0.1, 10.0)  # believed, on the configured noise


def with_residual_noise(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> tuple[StereoCamera, BundleProblem]:
    """Return the problem anew, weighted by the noise that the residuals of its solution show."""
    residual = _residuals_px(camera, problem, solution)
    seen = np.bincount(problem.point[~solution.outliers], minlength=problem.points_m.shape[1])
    used = ~solution.outliers & (seen[problem.point] >= _MIN_SEEN)
    pixel = _factor(residual[:2] * np.sqrt(problem.inv_sigma2), used)
    disparity = problem.measured_px[0] - problem.measured_px[2]
    normalised = (residual[0] - residual[2]) / camera.disparity_sigma_px(disparity)
    depth = _factor(normalised, used & np.isfinite(disparity))
    sharper = replace(
        camera,
        disparity_noise_px=camera.disparity_noise_px * depth,
        relative_noise=camera.relative_noise * depth,
    )
    return sharper, replace(problem, inv_sigma2=problem.inv_sigma2 / pixel**2)


def _residuals_px(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> FloatArray:
    """Return (3, M) of u, v, u_right; those behind a camera are among the outliers."""
    T = solution.T_camera_map[problem.camera]
    x = np.einsum('mij,jm->mi', T[:, :3, :3], solution.points_m[:, problem.point]) + T[:, :3, 3]
    x[:, 2] = np.where(x[:, 2] > 0, x[:, 2], np.inf)
    return problem.measured_px - camera.project(x).T


def _factor(normalised: FloatArray, used: BoolArray) -> float:
    """Return the standard deviation of residuals (..., M) in units of the configured one."""
    if np.count_nonzero(used) < _MIN_OBSERVATIONS:
        return 1.0
    return noise_factor(normalised[..., used])


def noise_factor(normalised: FloatArray) -> float:
    """Return the standard deviation of residuals, of any shape, in units of the configured one."""
    sizes = np.abs(normalised).ravel()
    middle = len(sizes) // 2
    median = float(np.partition(sizes, middle)[middle])  # a third of what np.median takes
    low, high = _FACTORS
    return min(max(_SIGMA_PER_MEDIAN * median, low), high)
