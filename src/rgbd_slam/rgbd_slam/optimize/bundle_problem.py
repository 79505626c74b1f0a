"""Bundle adjustment of a window of keyframes by a dense solver.

The reduced camera system has six unknowns per keyframe. It is so small that a dense Schur
complement solves it many times faster than a general factor graph (decision 013).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, CHI2_STEREO, GATES


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Keyframes, points and observations as parallel arrays.

    Attributes:
        T_camera_map: (C, 4, 4) poses of the keyframes; the first `num_free` are optimized.
        num_free: Number of optimized keyframes.
        points_m: (3, P) points in the map frame.
        camera: (M,) index of the keyframe of each observation.
        point: (M,) index of the point of each observation. A keyframe observes a point at most
            once.
        measured_px: (3, M) u, v, u_right; u_right is NaN without depth.
        inv_sigma2: (M,) 1 / variance of u, and equally of v, of each observation [1/px^2]. The
            outlier test applies it to u_right as well. In the fit, the disparity u - u_right has a
            variance of its own, which the camera states, unless `joint_noise` is on.
    """

    T_camera_map: FloatArray
    num_free: int
    points_m: FloatArray
    camera: IntArray
    point: IntArray
    measured_px: FloatArray
    inv_sigma2: FloatArray


class BundleSolution(NamedTuple):
    """Adjusted poses and points, and the observations that do not fit them."""

    T_camera_map: FloatArray  # (C, 4, 4)
    points_m: FloatArray  # (3, P)
    outliers: BoolArray  # (M,)


def adjust(
    camera: StereoCamera, problem: BundleProblem, iterations: int, rounds: int = 2
) -> BundleSolution:
    """Return adjusted poses and points. Each round leaves out the outliers of the round before.

    The noise of the camera weights the residuals, whose kernels are Huber's. `iterations` is the
    largest number in each round.
    """
    fit = hoid_native.adjust_bundle(
        camera.lens,
        GATES,
        problem.T_camera_map,
        problem.num_free,
        problem.points_m.T,
        problem.camera,
        problem.point,
        problem.measured_px.T,
        problem.inv_sigma2,
        rounds,
        iterations,
    )
    gate = np.where(np.isfinite(problem.measured_px[2]), CHI2_STEREO, CHI2_MONO)
    return BundleSolution(fit.T_camera_map, fit.points_m.T, fit.chi2 > gate)
