"""Bundle adjustment by GTSAM, for problems that are too large for the dense solver.

GTSAM stores the camera-point blocks sparsely, so that memory grows with the number of
observations, not with the product of keyframes and points. The noise is that of the dense solver:
pixels, and disparities where a feature has depth. Two things differ: one Huber kernel covers
both, where the dense solver has two, and `joint_noise` is not supported.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.projection import to_camera
from rgbd_slam.optimize.bundle_problem import BundleProblem, BundleSolution
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, CHI2_STEREO

_RELATIVE_TOLERANCE = 1e-4  # chosen: smaller changes of the cost move poses by micrometers
# Chosen: steps of 17 % in the standard deviation of disparities [px]. One noise model is made for
# each step instead of each observation.
_NOISE_STEPS = np.geomspace(0.01, 20.0, 48)


def solve_bundle_gtsam(
    camera: StereoCamera, problem: BundleProblem, iterations: int
) -> BundleSolution:
    """Return the adjusted poses of the free cameras and of all points, with a Huber kernel.

    At least one camera must be fixed, and every point must be observed.
    """
    graph = _factors(camera, problem)
    values = gtsam.Values()
    for i, T in enumerate(problem.T_camera_map):
        pose = gtsam.Pose3(se3.inverse(T))
        values.insert(X(i), pose)
        if i >= problem.num_free:
            graph.add(gtsam.NonlinearEqualityPose3(X(i), pose))
    for j, point in enumerate(problem.points_m.T):
        values.insert(L(j), point)
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(_RELATIVE_TOLERANCE)
    params.setOrdering(_points_first(problem))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    before = optimizer.error()
    result = optimizer.optimize()
    poses = [result.atPose3(X(i)).matrix() for i in range(len(problem.T_camera_map))]
    points = [result.atPoint3(L(j)) for j in range(problem.points_m.shape[1])]
    T_camera_map = se3.inverse(np.array(poses))
    points_m = np.array(points).reshape(-1, 3).T
    outliers = _chi2(camera, problem, T_camera_map, points_m) > _gates(problem)
    # The error of GTSAM is half the cost of the dense solver.
    return BundleSolution(T_camera_map, points_m, outliers, 2 * before, 2 * optimizer.error())


def _gates(problem: BundleProblem) -> FloatArray:
    return np.where(np.isfinite(problem.measured_px[2]), CHI2_STEREO, CHI2_MONO)


def _chi2(
    camera: StereoCamera, problem: BundleProblem, T_camera_map: FloatArray, points_m: FloatArray
) -> FloatArray:
    """Return (M,) squared normalized residuals; infinite behind a camera."""
    x = np.empty((3, len(problem.point)))
    for i, T in enumerate(T_camera_map):
        seen = problem.camera == i
        x[:, seen] = to_camera(T, points_m[:, problem.point[seen]])
    behind = x[2] <= 0
    x[2, behind] = 1.0
    residual = camera.project_rows(x) - problem.measured_px
    chi2: FloatArray = problem.inv_sigma2 * np.nansum(residual**2, axis=0)
    chi2[behind] = np.inf
    return chi2


def _points_first(problem: BundleProblem) -> gtsam.Ordering:
    """Return the order that eliminates points before cameras: faster than COLAMD here."""
    ordering = gtsam.Ordering()
    for j in range(problem.points_m.shape[1]):
        ordering.push_back(L(j))
    for i in range(len(problem.T_camera_map)):
        ordering.push_back(X(i))
    return ordering


def _factors(camera: StereoCamera, problem: BundleProblem) -> gtsam.NonlinearFactorGraph:
    pinhole = (camera.fx_px, camera.fy_px, 0.0, camera.cx_px, camera.cy_px)
    mono_camera = gtsam.Cal3_S2(*pinhole)
    stereo_camera = gtsam.Cal3_S2Stereo(*pinhole, camera.baseline_px_m / camera.fx_px)
    weights = np.unique(problem.inv_sigma2)  # one for each octave
    mono_noise = [_mono_noise(weight) for weight in weights]
    stereo_noise = [[_stereo_noise(weight, part) for part in _NOISE_STEPS] for weight in weights]
    graph = gtsam.NonlinearFactorGraph()
    rows = zip(
        problem.camera.tolist(),
        problem.point.tolist(),
        problem.measured_px.T.astype(np.float64),
        np.searchsorted(weights, problem.inv_sigma2).tolist(),
        _noise_steps(camera, problem).tolist(),
        strict=True,
    )
    for i, j, measured, level, step in rows:
        u, v, u_right = measured
        if np.isnan(u_right):
            mono = gtsam.GenericProjectionFactorCal3_S2(
                measured[:2], mono_noise[level], X(i), L(j), mono_camera, False, False
            )
            graph.add(mono)
        else:
            stereo = gtsam.GenericStereoFactor3D(
                gtsam.StereoPoint2(u, u_right, v),
                stereo_noise[level][step],
                X(i),
                L(j),
                stereo_camera,
                False,
                False,
            )
            graph.add(stereo)
    return graph


def _noise_steps(camera: StereoCamera, problem: BundleProblem) -> IntArray:
    """Return the (M,) indices of the steps nearest to the noise of each disparity."""
    disparity = np.nan_to_num(problem.measured_px[0] - problem.measured_px[2])
    middles = np.sqrt(_NOISE_STEPS[1:] * _NOISE_STEPS[:-1])
    return np.asarray(np.searchsorted(middles, camera.disparity_sigma_px(disparity)), np.int64)


def _mono_noise(inv_sigma2: float) -> gtsam.noiseModel.Robust:
    noise = gtsam.noiseModel.Isotropic.Sigma(2, float(inv_sigma2**-0.5))
    return _robust(noise, CHI2_MONO)


def _stereo_noise(inv_sigma2: float, disparity_sigma_px: float) -> gtsam.noiseModel.Robust:
    """Return the noise of (u, u_right, v) for independent u, v and u - u_right."""
    pixel2, disparity2 = 1.0 / inv_sigma2, disparity_sigma_px**2
    covariance = np.array(
        [[pixel2, pixel2, 0.0], [pixel2, pixel2 + disparity2, 0.0], [0.0, 0.0, pixel2]]
    )
    return _robust(gtsam.noiseModel.Gaussian.Covariance(covariance), CHI2_STEREO)


def _robust(noise: gtsam.noiseModel.Gaussian, chi2: float) -> gtsam.noiseModel.Robust:
    huber = gtsam.noiseModel.mEstimator.Huber.Create(float(np.sqrt(chi2)))
    return gtsam.noiseModel.Robust.Create(huber, noise)
