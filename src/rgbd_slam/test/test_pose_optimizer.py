"""Poses of single images: their covariances, their outliers and their priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.measured_noise import with_image_noise
from rgbd_slam.optimize.pose_optimizer import (
    PoseEstimate,
    PosePrior,
    PoseProblem,
    covariance,
    optimize_pose,
)

CAMERA = StereoCamera.from_model(CameraModel(640, 480, 520.0, 520.0, 320.0, 240.0), CameraConfig())
SAMPLES = 200


def variance_ratios(noise: float, usual_noise: float | None = None) -> tuple[float, float]:
    """Return the smallest and the largest ratio of true to published variance at a pixel noise.

    The usual noise is that of the images before; None: the same.
    """
    rng = np.random.default_rng(0)
    camera = replace(CAMERA, pixel_noise=noise if usual_noise is None else usual_noise)
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
        problem = PoseProblem(points_m, measured_px, scale**-2.0)
        if usual_noise is not None:
            problem = with_image_noise(camera, problem, np.eye(4))
        estimate = optimize_pose(camera, problem, np.eye(4))
        twists.append(se3.log(estimate.T_camera_map))
        published.append(covariance(estimate))
    claimed, true = np.mean(published, axis=0), np.cov(np.array(twists).T)
    root = np.linalg.inv(np.linalg.cholesky(claimed))
    ratios = np.linalg.eigvalsh(root @ true @ root.T)  # in all directions, whatever the units
    return float(ratios[0]), float(ratios[-1])


@pytest.mark.parametrize('noise', [1.0, 1.5, 2.0])
def test_the_covariance_matches_the_errors(noise: float) -> None:
    least, greatest = variance_ratios(noise)
    assert least > 0.5
    assert greatest < 2.0


def test_the_covariance_of_a_blurred_image_matches_its_errors() -> None:
    least, greatest = variance_ratios(3.0, usual_noise=0.6)
    assert least > 0.5
    assert greatest < 2.0


def test_a_noise_below_the_configured_one_does_not_reduce_the_covariance() -> None:
    """Errors that all pixels of an image share do not average out."""
    _, greatest = variance_ratios(0.5)
    assert greatest < 0.5


@pytest.mark.parametrize('beyond_m', [0.001, -0.001])
def test_the_kernel_and_the_tracker_have_the_same_least_depth(beyond_m: float) -> None:
    points_m = np.random.default_rng(0).uniform([-1.5, -1, 2], [1.5, 1, 5], (50, 3))
    points_m[0] = 0, 0, MIN_DEPTH_M + beyond_m
    measured_px = CAMERA.project(points_m)
    problem = PoseProblem(points_m, measured_px, np.ones(len(points_m)))
    inliers = optimize_pose(CAMERA, problem, np.eye(4)).inliers
    assert inliers[1:].all()
    assert inliers[0] == (beyond_m > 0)


@pytest.mark.parametrize('pixel_noise', [0.5, 1.0, 2.0])
def test_a_prior_counts_by_its_information(pixel_noise: float) -> None:
    """A prior with the same information as the matches moves the pose halfway to the prior."""
    points_m = np.random.default_rng(0).uniform([-1.5, -1, 2], [1.5, 1, 5], (200, 3))
    camera = replace(CAMERA, pixel_noise=pixel_noise)
    problem = PoseProblem(points_m, camera.project(points_m), np.ones(len(points_m)))
    alone = optimize_pose(camera, problem, np.eye(4))
    offset = np.array([1e-4, -2e-4, 1e-4, 4e-4, -3e-4, 2e-4])
    prior = PosePrior(se3.exp(offset), alone.information)
    both = optimize_pose(camera, problem, np.eye(4), prior)
    np.testing.assert_allclose(se3.log(both.T_camera_map), offset / 2, atol=2e-6)
    np.testing.assert_allclose(both.information, 2 * alone.information, rtol=0.01, atol=2e4)


@pytest.mark.parametrize('last', [0.0, 1e-14, -1e-14])
def test_the_variance_of_an_unconstrained_motion_is_that_of_an_unknown_pose(last: float) -> None:
    blind = PoseEstimate(
        np.eye(4), np.empty(0, np.bool_), np.diag([4.0, 2.0, 1.0, 5.0, 10.0, last])
    )
    np.testing.assert_allclose(np.diag(covariance(blind)), [0.25, 0.5, 1.0, 0.2, 0.1, 100.0])


def test_matches_on_one_line_do_not_say_how_far_the_camera_turned_about_it() -> None:
    """The line is vertical, 2 m in front of the camera."""
    points_m = np.column_stack([np.zeros(30), np.linspace(-1, 1, 30), np.full(30, 2.0)])
    problem = PoseProblem(points_m, CAMERA.project(points_m), np.ones(30))
    estimate = optimize_pose(CAMERA, problem, np.eye(4))
    found = covariance(estimate)
    turn = np.array([0.0, 1, 0, -2, 0, 0])  # about the line, as a twist of the camera
    turn /= np.linalg.norm(turn)
    assert turn @ found @ turn > 1.0
    assert (np.linalg.eigvalsh(found) > 0).all()
    assert np.sqrt(found[4, 4]) < 0.01  # along the line
