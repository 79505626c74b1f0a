"""A prior of the pose is weighed against the matches by its information."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hoid_native import Gates, StereoParams, optimize_pose

FloatArray = NDArray[np.float64]
CAMERA = StereoParams(500.0, 510.0, 320.0, 240.0, 40.0, 0.3, 0.02)
GATES = Gates(5.991, 7.815)
STRONG = 1e12 * np.eye(6)


def exp(twist: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of a twist, rotation first, by the series of the exponential."""
    hat = np.zeros((4, 4))
    hat[:3, :3] = np.cross(np.eye(3), -twist[:3])
    hat[:3, 3] = twist[3:]
    out, term = np.eye(4), np.eye(4)
    for n in range(1, 40):
        term = term @ hat / n
        out = out + term
    return out


def log(T: FloatArray) -> FloatArray:
    """Return the twist (6,) of a small motion, rotation first, by the series of the logarithm."""
    power, out = np.eye(4), np.zeros((4, 4))
    for n in range(1, 80):
        power = power @ (T - np.eye(4))
        out += (-1) ** (n + 1) / n * power
    return np.array([out[2, 1], out[0, 2], out[1, 0], *out[:3, 3]])


def pixels(T: FloatArray, points: FloatArray) -> FloatArray:
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    u = CAMERA.fx_px * x / z + CAMERA.cx_px
    return np.stack([u, CAMERA.fy_px * y / z + CAMERA.cy_px, u - CAMERA.disparity_px_m / z], 1)


TRUTH = exp(np.array([0.1, -0.2, 0.15, 0.1, -0.05, 0.2]))
PRIOR = exp(np.array([0.02, -0.06, 0.08, 0.1, -0.05, -0.1])) @ TRUTH


def matches(count: int = 100) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points, exact measurements and weights of matches at `TRUTH`."""
    points = np.random.default_rng(3).uniform([-1.5, -1, 1.5], [1.5, 1, 5], (count, 3))
    return points, pixels(TRUTH, points), np.ones(count)


def test_without_a_prior_the_result_is_bit_for_bit_the_same() -> None:
    plain = optimize_pose(CAMERA, GATES, *matches(), np.eye(4))
    none = optimize_pose(CAMERA, GATES, *matches(), np.eye(4), None, None)
    zero = optimize_pose(CAMERA, GATES, *matches(), np.eye(4), PRIOR, np.zeros((6, 6)))
    for fit in (none, zero):
        for expected, found in zip(plain, fit, strict=True):
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize('count', [100, 3, 0])
def test_a_prior_with_unbounded_information_wins(count: int) -> None:
    fit = optimize_pose(CAMERA, GATES, *matches(count), np.eye(4), PRIOR, STRONG)
    np.testing.assert_allclose(fit.T_camera_map, PRIOR, atol=1e-6)


def test_the_result_is_the_minimum_of_both_costs() -> None:
    """The gradient of the sum of both costs, computed by SciPy, vanishes at the result."""
    points, measured, weight = matches()
    measured[:, 2] = np.nan
    information = np.diag([4e4, 2e4, 1e4, 2e5, 1e5, 3e5])
    wide = Gates(1e12, 1e12)  # no outliers, no robust kernel
    fit = optimize_pose(CAMERA, wide, points, measured, weight, TRUTH, PRIOR, information)

    def residuals(twist: FloatArray) -> FloatArray:
        T = exp(twist) @ TRUTH
        prior = np.sqrt(information) @ log(T @ np.linalg.inv(PRIOR))
        return np.concatenate([(pixels(T, points) - measured)[:, :2].ravel(), prior])

    best = least_squares(residuals, np.zeros(6), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(fit.T_camera_map, exp(best.x) @ TRUTH, atol=1e-6)
    assert 0.01 < np.linalg.norm(log(fit.T_camera_map @ np.linalg.inv(PRIOR))) < 0.17


def test_the_information_of_the_prior_is_added() -> None:
    information = np.diag([4.0, 2.0, 1.0, 5.0, 3.0, 6.0])
    fit = optimize_pose(CAMERA, GATES, *matches(0), PRIOR, PRIOR, information)
    np.testing.assert_allclose(fit.information, information, atol=1e-9)


@pytest.mark.parametrize(
    ('prior', 'information', 'reason'),
    [
        (PRIOR, None, 'needs a pose and its information'),
        (None, STRONG, 'needs a pose and its information'),
        (PRIOR, np.full((6, 6), np.inf), 'prior_information'),
        (np.full((4, 4), np.nan), STRONG, 'prior_T_camera_map'),
    ],
)
def test_an_incomplete_prior_is_refused(
    prior: FloatArray | None, information: FloatArray | None, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        optimize_pose(CAMERA, GATES, *matches(), np.eye(4), prior, information)
