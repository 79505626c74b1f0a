"""The noise of pixels and depth, measured from residuals of tracked frames or an adjusted map.

The configured noise is large, so that it holds for any depth camera. But the weights and the
robust kernels depend on the true ratio of pixel noise to depth noise, which depends on the camera,
the distance and blur (decision 003). With the measured noise, the trajectory around a loop is up
to twice as accurate (docs/results/places_and_loops.md). Standard deviations are computed from
medians, because the tails are outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.values import Float32Array, FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.optimize.bundle_adjustment import BundleProblem, BundleSolution
from rgbd_slam.optimize.pose_optimizer import PoseProblem

# Ratio of the standard deviation to the median absolute value of a normal distribution: 1 /
# 0.6745.
_SIGMA_PER_MEDIAN = 1.4826
_MIN_OBSERVATIONS = 500  # least number of observations for a measured noise; not tuned
# A point with fewer observations adapts to them, so that their residuals are too small.
_MIN_OBSERVERS = 4
_FACTOR_RANGE = (0.1, 10.0)  # limits of the measured noise, as ratios to the configured one
_MIN_RESIDUALS = 50  # with fewer residuals, the noise of an image is not measured
_PRIOR_IMAGES = 3  # weight of the configured noise, as a number of images
_MAX_IMAGES = 100  # number of images over which variances are averaged: about three seconds


class NoiseEstimator:
    """Averages the variances of pixels and disparities over about the last 100 tracked frames."""

    def __init__(self, camera: StereoCamera) -> None:
        self.camera = camera  # camera with the measured noise
        self._configured = camera
        self._variances = np.ones(2)  # of pixels and disparities, as ratios to the configured ones
        self._num_images = _PRIOR_IMAGES

    def add(self, tracked: TrackedFrame, atlas: Atlas) -> None:
        self._num_images = min(self._num_images + 1, _MAX_IMAGES)
        step = self._factors(tracked, atlas) ** 2 - self._variances
        self._variances += np.nan_to_num(step) / self._num_images
        pixel, disparity = np.sqrt(self._variances).tolist()
        self.camera = self._configured.with_noise(pixel, disparity)

    def _factors(self, tracked: TrackedFrame, atlas: Atlas) -> FloatArray:
        """Return the noise of pixels and disparities as factors (2,); NaN: too few residuals."""
        k = np.flatnonzero(tracked.points != NO_POINT)
        position_m = atlas.points.position_m.take(tracked.points[k], 0)
        x = to_camera(se3.inverse(tracked.T_map_camera), position_m.T)
        expected = self._configured.project_rows(x)
        measured = tracked.frame.measurement_px.take(k, 0).T
        residual = measured - expected
        pixel = residual[:2] / atlas.octave_scale[tracked.frame.octave[k]]
        sigma_px = self._configured.disparity_sigma_px(measured[0] - measured[2])
        disparity = (residual[0] - residual[2]) / sigma_px
        disparity = disparity[np.isfinite(disparity)]
        return np.array([_factor(part, _MIN_RESIDUALS, np.nan) for part in (pixel, disparity)])


def with_image_noise(
    camera: StereoCamera, problem: PoseProblem, T_camera_map: FloatArray
) -> PoseProblem:
    """Return a problem with the noise measured from the residuals of all its matches at a pose.

    All matches are used because in blurred images most are outliers, while the inliers fit by
    chance and have small residuals.
    """
    x = to_camera(T_camera_map, problem.points_m.T)
    residual_px = problem.measured_px[:, :2].T - camera.project_rows(x)[:2]
    noise = _factor(residual_px * np.sqrt(problem.inv_sigma2), _MIN_RESIDUALS, 1.0)
    return replace(problem, variance=max(1.0, noise**2))


def with_residual_noise(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> tuple[StereoCamera, BundleProblem]:
    """Return camera and problem with the noise measured from the residuals of a solution.

    The camera gets the measured noise of depth, the problem that of pixels. A noise with fewer
    than 500 suitable observations is not changed.
    """
    residual = _residuals_px(camera, problem, solution)
    seen = np.bincount(problem.point[~solution.outliers], minlength=problem.points_m.shape[1])
    used = ~solution.outliers & (seen[problem.point] >= _MIN_OBSERVERS)
    pixels = (residual[:2] * np.sqrt(problem.inv_sigma2))[:, used]
    pixel = _factor(pixels, 2 * _MIN_OBSERVATIONS, 1.0)
    disparity = problem.measured_px[0] - problem.measured_px[2]
    normalized = (residual[0] - residual[2]) / camera.disparity_sigma_px(disparity)
    depth = _factor(normalized[used & np.isfinite(disparity)], _MIN_OBSERVATIONS, 1.0)
    sharper = camera.with_noise(1.0, depth)
    return sharper, replace(problem, inv_sigma2=problem.inv_sigma2 / pixel**2)


def _residuals_px(
    camera: StereoCamera, problem: BundleProblem, solution: BundleSolution
) -> FloatArray:
    """Return the residuals (3, M) of u, v, u_right in px; arbitrary behind a camera."""
    T = solution.T_camera_map[problem.camera]
    x = np.einsum('mij,jm->mi', T[:, :3, :3], solution.points_m[:, problem.point]) + T[:, :3, 3]
    x[:, 2] = np.where(x[:, 2] > 0, x[:, 2], np.inf)
    return problem.measured_px - camera.project(x).T


def median(values: FloatArray | Float32Array) -> float:
    """Return the median of values (N,) without NaN, N > 0, in a quarter of np.median's time."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    low, high = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((low + high) / 2)


def _factor(normalized: FloatArray, min_size: int, default: float) -> float:
    """Return the sigma of normalized residuals, limited to 0.1..10; `default` if too few."""
    if normalized.size < min_size:
        return default
    sizes = np.abs(normalized).ravel()
    middle = len(sizes) // 2
    median = float(np.partition(sizes, middle)[middle])  # 3 times as fast as np.median
    low, high = _FACTOR_RANGE
    return min(max(_SIGMA_PER_MEDIAN * median, low), high)
