"""The noise of poses is estimated from their deviations from a smooth motion."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.tracking.pose_noise import LastingNoise, PoseNoise

PERIOD_NS = 33_333_333
SIGMA = np.array([1e-3, 2e-3, 5e-4, 2e-3, 1e-3, 4e-3])  # rad, m


def smooth(count: int) -> FloatArray:
    """Return poses of a camera that moves smoothly, as fast as a hand."""
    t_s = 1e-9 * PERIOD_NS * np.arange(count)
    twist = np.zeros((count, 6))
    twist[:, 1] = 0.2 * np.sin(2 * t_s)
    twist[:, 3] = 0.3 * np.sin(3 * t_s)
    twist[:, 5] = 0.5 * t_s
    return se3.exp(twist)


NO_PRIOR = np.zeros((6, 6))


def measured(T: FloatArray, period_ns: int = PERIOD_NS) -> FloatArray | None:
    noise = PoseNoise()
    for n, T_odom_camera in enumerate(T):
        noise.add(n * period_ns, T_odom_camera)
    return noise.covariance(NO_PRIOR)


def test_a_known_noise_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, SIGMA, (400, 6))
    covariance = measured(smooth(400) @ se3.exp(noise))
    assert covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), SIGMA, rtol=0.3)  # 60 samples
    correlation = covariance / np.outer(SIGMA, SIGMA)
    assert np.abs(correlation - np.diag(np.diag(correlation))).max() < 0.5


def test_a_smooth_motion_has_hardly_any_noise() -> None:
    covariance = measured(smooth(60))
    assert covariance is not None
    sigma = np.sqrt(np.diag(covariance))
    assert np.degrees(sigma[:3]).max() < 0.005
    assert sigma[3:].max() < 0.0002


@pytest.mark.parametrize(
    ('count', 'period_ns'), [(4, PERIOD_NS), (60, 100_000_000)], ids=['too few', 'too slow']
)
def test_few_or_infrequent_images_give_no_covariance(count: int, period_ns: int) -> None:
    assert measured(smooth(count), period_ns) is None


def test_a_step_between_two_motions_is_no_noise() -> None:
    noise, T = PoseNoise(), smooth(60)
    for n in range(60):
        if n == 30:
            noise.restart()
        step = se3.exp(np.array([0.0, 0.5, 0, 1, 0, 0])) if n >= 30 else np.eye(4)
        noise.add(n * PERIOD_NS, T[n] @ step)
    covariance = noise.covariance(NO_PRIOR)
    assert covariance is not None
    assert np.sqrt(np.diag(covariance)).max() < 0.001


def test_the_prior_outweighs_few_samples() -> None:
    noise, T = PoseNoise(), smooth(70)
    shares = []
    for n in range(70):
        noise.add(n * PERIOD_NS, T[n])
        covariance = noise.covariance(np.eye(6))
        shares.append(None if covariance is None else covariance[0, 0])
    assert shares[:4] == [None] * 4
    assert shares[4] == pytest.approx(5 / 6, rel=1e-3)
    assert shares[-1] == pytest.approx(5 / 65, rel=1e-3)


def test_images_at_nearly_the_same_time_give_a_finite_covariance() -> None:
    noise = PoseNoise()
    for stamp_ns, T_odom_camera in zip((0, 1, 2, 3, 200_000_000), smooth(5), strict=True):
        noise.add(stamp_ns, T_odom_camera)
    covariance = noise.covariance(np.eye(6))
    assert covariance is not None
    assert np.isfinite(covariance).all()


def test_a_difference_of_halves_that_lasts_is_measured_and_noise_is_not() -> None:
    rng, noise = np.random.default_rng(0), LastingNoise()
    independent = np.diag(SIGMA**2)
    for _ in range(200):
        twist = rng.normal(0, SIGMA)
        noise.add(np.outer(twist, twist) - independent)
    assert (np.diag(noise.covariance) < 0.3 * SIGMA**2).all()
    for _ in range(400):
        twist = rng.normal(0, SIGMA) + 3 * SIGMA
        noise.add(np.outer(twist, twist) - independent)
    np.testing.assert_allclose(np.diag(noise.covariance), 4.5 * SIGMA**2, rtol=0.3)
    assert (np.linalg.eigvalsh(noise.covariance) > -1e-15).all()
