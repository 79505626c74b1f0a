"""The pose of one image from matched map points: robust Gauss-Newton on (u, v, u_right)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.frame import StereoCamera
from rgbd_slam.projection import pose_jacobian, project, to_camera

CHI2_MONO = 5.991  # 95 % quantiles of 2 and 3 degrees of freedom
CHI2_STEREO = 7.815
MIN_DEPTH_M = 0.05
_ROUNDS = (
    (4, True),
    (3, True),
    (3, False),
)  # iterations, robust; outliers are told anew after each
_MIN_POINTS = 4
_CONVERGED = 1e-7


class PoseEstimate(NamedTuple):
    """A pose and what supports it."""

    T_camera_map: FloatArray  # (4, 4)
    inliers: BoolArray  # (N,)
    information: FloatArray  # (6, 6) of the left twist, rotation first, at the solution


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """Matches of one image as rows of coordinates.

    Attributes:
        points_m: (3, N) in the map's frame.
        measured_px: (3, N) u, v, u_right; NaN for u_right without depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
    """

    points_m: FloatArray
    measured_px: FloatArray
    inv_sigma2: FloatArray


class PoseOptimizer:
    """Optimises poses; keeps its work space, as big allocations cost more than the sums."""

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self._reserve(1024)

    def _reserve(self, size: int) -> None:
        self._jacobian = np.empty(18 * size)
        self._weighted = np.empty(18 * size)
        self._residual = np.empty(3 * size)
        self._size = size

    def optimize(self, problem: PoseProblem, T_camera_map: FloatArray) -> PoseEstimate:
        """Return the pose that explains the matches best, from an initial one."""
        stereo = np.isfinite(problem.measured_px[2])
        gate = np.where(stereo, CHI2_STEREO, CHI2_MONO)
        weight = np.repeat(problem.inv_sigma2[None], 3, axis=0)
        weight[2, ~stereo] = 0.0
        measured = np.where(np.isfinite(problem.measured_px), problem.measured_px, 0.0)
        inliers = np.ones(len(gate), np.bool_)
        information = np.eye(6)
        T = T_camera_map
        for iterations, robust in _ROUNDS:
            if np.count_nonzero(inliers) < _MIN_POINTS:
                break
            some = inliers
            T, information = self._iterate(
                T, problem.points_m[:, some], measured[:, some], weight[:, some], gate[some],
                iterations, robust=robust,
            )  # fmt: skip
            inliers = self._chi2(T, problem.points_m, measured, weight) <= gate
        return PoseEstimate(se3.orthonormalized(T), inliers, information)

    def _iterate(
        self,
        T: FloatArray,
        points_m: FloatArray,
        measured: FloatArray,
        weight: FloatArray,
        gate: FloatArray,
        iterations: int,
        *,
        robust: bool,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the pose and its information after some Gauss-Newton steps."""
        n = points_m.shape[1]
        if n > self._size:
            self._reserve(2 * n)
        jacobian = self._jacobian[: 18 * n].reshape(6, 3, n)
        weighted = self._weighted[: 18 * n].reshape(6, 3, n)
        residual = self._residual[: 3 * n].reshape(3, n)
        information = np.eye(6)
        for _ in range(iterations):
            x = to_camera(T, points_m)
            np.maximum(x[2], MIN_DEPTH_M, out=x[2])
            inv_z = project(self._camera, x, residual)
            np.subtract(measured, residual, out=residual)
            w = weight
            if robust:
                chi2 = (weight * residual**2).sum(0)
                w = weight * np.sqrt(
                    gate / np.maximum(chi2, gate)
                )  # Huber: 1 inside, 1 / |e| outside
            pose_jacobian(self._camera, x, inv_z, jacobian)
            np.multiply(jacobian, w, out=weighted)
            flat = weighted.reshape(6, -1)
            information = np.asarray(flat @ jacobian.reshape(6, -1).T)
            try:
                step = np.asarray(
                    np.linalg.solve(information, flat @ residual.ravel()), np.float64
                )
            except np.linalg.LinAlgError:
                break
            T = se3.exp(step) @ T
            if float(step @ step) < _CONVERGED**2:
                break
        return T, information

    def _chi2(
        self, T: FloatArray, points_m: FloatArray, measured: FloatArray, weight: FloatArray
    ) -> FloatArray:
        """Return (N,) squared normalised residuals; infinite behind the camera."""
        x = to_camera(T, points_m)
        behind = x[2] < MIN_DEPTH_M
        x[2][behind] = 1.0
        residual = np.empty_like(x)
        project(self._camera, x, residual)
        residual -= measured
        chi2: FloatArray = (weight * residual**2).sum(0)
        chi2[behind] = np.inf
        return chi2


def covariance(estimate: PoseEstimate) -> FloatArray:
    """Return (6, 6) of a small motion in the camera's own frame, rotation first [rad^2, m^2]."""
    return np.asarray(np.linalg.pinv(estimate.information, hermitian=True))
