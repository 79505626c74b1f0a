"""The pose of one image from matches with map points: robust Gauss-Newton on (u, v, u_right)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.frame import Frame, StereoCamera

CHI2_MONO = 5.991  # 95 % quantile of chi-square, two degrees of freedom: (u, v)
CHI2_STEREO = 7.815  # three degrees of freedom: (u, v, u_right)
GATES = hoid_native.Gates(CHI2_MONO, CHI2_STEREO)
# Chosen: standard deviations of half a turn and 10 m, more than a camera moves while it is lost.
_UNKNOWN_SIGMAS: FloatArray = np.array([np.pi] * 3 + [10.0] * 3)
UNKNOWN_COVARIANCE = np.diag(np.square(_UNKNOWN_SIGMAS))
"""Covariance (6, 6) of a pose of which nothing is known, rotation first [rad^2, m^2]."""


class PoseEstimate(NamedTuple):
    """The estimated pose of an image, its information and its inliers."""

    T_camera_map: FloatArray  # (4, 4)
    inliers: BoolArray  # (N,)
    information: FloatArray  # (6, 6) of the left twist, rotation first [1/rad^2, 1/m^2]
    # Share of the variance that is due to errors that differ from image to image.
    independent_share: float = 1.0


class PosePrior(NamedTuple):
    """A Gaussian prior of a pose, such as the prediction of an IMU."""

    T_camera_map: FloatArray  # (4, 4)
    information: FloatArray  # (6, 6) of the left twist, rotation first [1/rad^2, 1/m^2]


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """N matches of one image with landmarks, which are map points or depth measurements.

    The outlier test applies `inv_sigma2` to u_right as well. In the fit, the disparity u - u_right
    has a variance of its own, which the camera states, unless `joint_noise` is on.
    """

    points_m: FloatArray  # (N, 3) landmarks in the map frame
    measured_px: FloatArray  # (N, 3) u, v, u_right; u_right is NaN without depth
    inv_sigma2: FloatArray  # (N,) 1 / variance of u, and equally of v [1/px^2]
    # Measured pixel variance of this image as a ratio of the configured variance; at least 1.
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
        """Return the three arrays in the order of the arguments of `hoid_native`'s functions."""
        return self.points_m, self.measured_px, self.inv_sigma2

    def select(self, keep: BoolArray) -> PoseProblem:
        k = np.flatnonzero(keep)  # looked up once, not three times
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
    """Return the pose that fits the matches, and a prior if one is given, best.

    The camera has its measured noise. The information is that of the configured pixel noise, or of
    the measured one if that is larger, as in blurred images. A smaller measured noise is not used,
    because errors that all matches share do not average out (decision 032).
    """
    # The kernel weights pixels by their configured variance, and disparities and the prior
    # relative to them; the measured variance scales the sum of all.
    variance = camera.pixel_noise**2
    scale = max(variance, problem.variance)
    weighted = () if prior is None else (prior.T_camera_map, scale * prior.information)
    fit = hoid_native.optimize_pose(camera.lens, GATES, *problem.arrays, T_camera_map, *weighted)
    return PoseEstimate(fit.T_camera_map, fit.inliers, fit.information / scale, min(1.0, variance))


def covariance(estimate: PoseEstimate) -> FloatArray:
    """Return the (6, 6) covariance of a pose in the camera frame, rotation first [rad^2, m^2].

    Along motions that the matches do not constrain, the variance is that of an unknown pose.
    """
    try:
        inverse = np.linalg.inv(estimate.information)
    except np.linalg.LinAlgError:  # the matches do not constrain one of the six motions at all
        inverse = np.zeros((6, 6))
    variances = np.diag(inverse)
    if ((variances > 0) & (variances < np.square(_UNKNOWN_SIGMAS))).all():
        return np.asarray(inverse)
    # Rounding errors decide the inverse of a singular matrix: its eigenvalues are limited instead.
    in_sigmas = _UNKNOWN_SIGMAS[:, None] * estimate.information * _UNKNOWN_SIGMAS
    eigenvalues, axes = np.linalg.eigh(in_sigmas)
    root = _UNKNOWN_SIGMAS[:, None] * axes / np.sqrt(np.maximum(eigenvalues, 1))
    return np.asarray(root @ root.T)
