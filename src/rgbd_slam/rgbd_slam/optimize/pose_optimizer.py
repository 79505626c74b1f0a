"""The pose of an image from matches with map points, by robust Gauss-Newton on (u, v, u_right)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.frame import Frame, StereoCamera

CHI2_MONO = 5.991  # 95 % quantile of chi-square with two degrees of freedom: (u, v)
CHI2_STEREO = 7.815  # 95 % quantile with three degrees of freedom: (u, v, u_right)
GATES = hoid_native.Gates(CHI2_MONO, CHI2_STEREO)
# Standard deviations of an unknown pose. Chosen: half a turn and 10 m, more than a camera moves
# while it is lost.
_UNKNOWN_SIGMAS: FloatArray = np.array([np.pi] * 3 + [10.0] * 3)
UNKNOWN_COVARIANCE = np.diag(np.square(_UNKNOWN_SIGMAS))
"""Covariance (6, 6) of a pose of which nothing is known, rotation first [rad^2, m^2]."""


class PoseEstimate(NamedTuple):
    """The estimated pose of an image, with its information matrix and its inliers."""

    T_camera_map: FloatArray  # (4, 4)
    inliers: BoolArray  # (N,)
    # (6, 6) information of the left twist, rotation first (1/rad^2, 1/m^2).
    information: FloatArray
    # Ratio of the variance from errors that are independent between images.
    independent_share: float = 1.0


class PosePrior(NamedTuple):
    """A Gaussian prior of a pose, such as the prediction of an IMU."""

    T_camera_map: FloatArray  # (4, 4)
    # (6, 6) information of the left twist, rotation first (1/rad^2, 1/m^2).
    information: FloatArray


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """N matches of an image with landmarks, which are map points or depth measurements.

    The outlier test uses `inv_sigma2` for u_right too. In the fit, the disparity u - u_right has
    its own variance, which follows from the camera's noise, unless it has `joint_noise`.
    """

    points_m: FloatArray  # (N, 3) landmarks in the map frame
    measured_px: FloatArray  # (N, 3) u, v, u_right; u_right is NaN without depth
    inv_sigma2: FloatArray  # (N,) 1 / variance of u and of v (1/px^2)
    # Ratio of the pixel variance measured in this image to the configured one; at least 1.
    variance: float = 1.0

    @classmethod
    def of(
        cls, frame: Frame, k: IntArray, points_m: FloatArray, octave_scale: FloatArray
    ) -> PoseProblem:
        """Return the problem of features `k` (N,) of a frame that observe landmarks (N, 3)."""
        measured_px = frame.measurement_px.take(k, 0).astype(np.float64)
        return cls(points_m, measured_px, octave_scale[frame.octave[k]] ** -2.0)

    def __len__(self) -> int:
        return len(self.inv_sigma2)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the three arrays in the order in which `hoid_native`'s functions take them."""
        return self.points_m, self.measured_px, self.inv_sigma2

    def select(self, keep: BoolArray) -> PoseProblem:
        k = np.flatnonzero(keep)  # computed once for all three arrays
        return PoseProblem(
            self.points_m.take(k, 0),
            self.measured_px.take(k, 0),
            self.inv_sigma2[k],
            self.variance,
        )


def optimize_pose(
    camera: StereoCamera,
    problem: PoseProblem,
    T_camera_map: FloatArray,
    prior: PosePrior | None = None,
) -> PoseEstimate:
    """Return the pose that best fits the matches and the prior, if one is given.

    The camera has its measured noise. The information matrix uses the configured pixel noise, or
    the measured one if that is larger, as in blurred images. A smaller measured noise is not used,
    because errors that all matches share do not average out (decision 032).
    """
    # The kernel weights pixels by their configured variance, and disparities and the prior
    # relative to pixels. The measured variance is a factor on all.
    variance = camera.pixel_noise**2
    scale = max(variance, problem.variance)
    weighted = () if prior is None else (prior.T_camera_map, scale * prior.information)
    fit = hoid_native.optimize_pose(camera.lens, GATES, *problem.arrays, T_camera_map, *weighted)
    return PoseEstimate(fit.T_camera_map, fit.inliers, fit.information / scale, min(1.0, variance))


def covariance(estimate: PoseEstimate) -> FloatArray:
    """Return the covariance (6, 6) of a pose (rad^2, m^2) in the camera frame, rotation first.

    For motions that the matches do not constrain, the variance is that of an unknown pose.
    """
    try:
        inverse = np.linalg.inv(estimate.information)
    except np.linalg.LinAlgError:  # the matches do not constrain one of the six motions at all
        inverse = np.zeros((6, 6))
    variances = np.diag(inverse)
    if ((variances > 0) & (variances < np.square(_UNKNOWN_SIGMAS))).all():
        return np.asarray(inverse)
    # The inverse of a nearly singular matrix depends on rounding errors. Therefore its eigenvalues
    # are limited instead.
    in_sigmas = _UNKNOWN_SIGMAS[:, None] * estimate.information * _UNKNOWN_SIGMAS
    eigenvalues, axes = np.linalg.eigh(in_sigmas)
    root = _UNKNOWN_SIGMAS[:, None] * axes / np.sqrt(np.maximum(eigenvalues, 1))
    return np.asarray(root @ root.T)
