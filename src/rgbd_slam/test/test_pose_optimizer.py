"""Poses of single images: what is said of their errors is what the errors are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.projection import MIN_DEPTH_M
from rgbd_slam.optimize.pose_optimizer import PoseProblem, covariance, optimize_pose

CAMERA = StereoCamera.from_model(CameraModel(640, 480, 520.0, 520.0, 320.0, 240.0), CameraConfig())
SAMPLES = 200


def variance_ratios(noise: float) -> tuple[float, float]:
    """Return the least and the greatest of true variance over published, for noisy pixels."""
    rng = np.random.default_rng(0)
    camera = replace(CAMERA, pixel_noise=noise)  # as measured
    points_m = rng.uniform([-1.5, -1, 2], [1.5, 1, 5], (300, 3))
    scale: FloatArray = 1.2 ** rng.integers(0, 8, len(points_m)).astype(np.float64)
    exact_px = camera.project(points_m)
    disparity_px = exact_px[:, 0] - exact_px[:, 2]
    sigma_px = np.column_stack(
        [noise * scale, noise * scale, camera.disparity_sigma_px(disparity_px)]
    )
    twists, published = [], []
    for _ in range(SAMPLES):
        error_px = rng.normal(0, sigma_px)
        measured_px = exact_px + error_px
        measured_px[:, 2] = measured_px[:, 0] - disparity_px - error_px[:, 2]
        estimate = optimize_pose(
            camera, PoseProblem(points_m, measured_px, scale**-2.0), np.eye(4)
        )
        twists.append(se3.log(estimate.T_camera_map))
        published.append(covariance(estimate))
    told, true = np.mean(published, axis=0), np.cov(np.array(twists).T)
    root = np.linalg.inv(np.linalg.cholesky(told))
    ratios = np.linalg.eigvalsh(root @ true @ root.T)  # in all directions, whatever the units
    return float(ratios[0]), float(ratios[-1])


@pytest.mark.parametrize('noise', [1.0, 1.5, 2.0])
def test_the_covariance_is_that_of_the_errors(noise: float) -> None:
    least, greatest = variance_ratios(noise)
    assert least > 0.5
    assert greatest < 2.0


def test_less_noise_than_configured_is_not_believed() -> None:
    """What the pixels of an image err by together does not average out."""
    _, greatest = variance_ratios(0.5)
    assert greatest < 0.5


@pytest.mark.parametrize('beyond_m', [0.001, -0.001])
def test_the_kernel_leaves_out_what_is_nearer_than_the_tracker_projects(beyond_m: float) -> None:
    points_m = np.random.default_rng(0).uniform([-1.5, -1, 2], [1.5, 1, 5], (50, 3))
    points_m[0] = 0, 0, MIN_DEPTH_M + beyond_m
    measured_px = CAMERA.project(points_m)
    problem = PoseProblem(points_m, measured_px, np.ones(len(points_m)))
    inliers = optimize_pose(CAMERA, problem, np.eye(4)).inliers
    assert inliers[1:].all()
    assert inliers[0] == (beyond_m > 0)
