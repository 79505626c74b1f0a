"""The pose of one image from matched map points: robust Gauss-Newton on (u, v, u_right)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.model.frame import StereoCamera

CHI2_MONO = 5.991  # 95 % quantiles of 2 and 3 degrees of freedom
CHI2_STEREO = 7.815
GATES = hoid_native.Gates(CHI2_MONO, CHI2_STEREO)


class PoseEstimate(NamedTuple):
    """A pose and what supports it."""

    T_camera_map: FloatArray  # (4, 4)
    inliers: BoolArray  # (N,)
    information: FloatArray  # (6, 6) of the left twist, rotation first [1/rad^2, 1/m^2]
    own_share: float = 1.0  # of its variance: what images in a row do not all err by


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """Matches of one image.

    Attributes:
        points_m: (N, 3) in the map's frame.
        measured_px: (N, 3) u, v, u_right; NaN for u_right without depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
    """

    points_m: FloatArray
    measured_px: FloatArray
    inv_sigma2: FloatArray

    def __len__(self) -> int:
        return len(self.inv_sigma2)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return all three in order, as kernels take them."""
        return self.points_m, self.measured_px, self.inv_sigma2

    def select(self, keep: BoolArray) -> PoseProblem:
        """Return the matches of an (N,) mask."""
        k = np.flatnonzero(keep)  # looked up once, not three times
        return PoseProblem(
            self.points_m.take(k, 0), self.measured_px.take(k, 0), self.inv_sigma2[k]
        )


def optimize_pose(
    camera: StereoCamera, problem: PoseProblem, T_camera_map: FloatArray
) -> PoseEstimate:
    """Return the pose that explains the matches best, from an initial one.

    Three rounds, after each of which outliers are told anew. The information is told from the
    noise of pixels as configured, or as measured where that is more, as of blurred images; where
    it is less it leaves out what errs together.
    """
    fit = hoid_native.optimize_pose(camera.lens, GATES, *problem.arrays, T_camera_map)
    # In the sums pixels have their configured weights and disparities are weighed against them, so
    # that the measured noise scales all of it alike.
    variance = camera.pixel_noise**2
    information = fit.information / max(1.0, variance)
    return PoseEstimate(fit.T_camera_map, fit.inliers, information, min(1.0, variance))


def covariance(estimate: PoseEstimate) -> FloatArray:
    """Return (6, 6) of a small motion in the camera's own frame, rotation first [rad^2, m^2]."""
    try:
        return np.asarray(np.linalg.inv(estimate.information))
    except np.linalg.LinAlgError:  # a motion that nothing tells of
        return np.asarray(np.linalg.pinv(estimate.information, hermitian=True))
