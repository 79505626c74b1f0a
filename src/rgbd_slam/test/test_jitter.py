"""The jitter of poses is told from the poses alone."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.tracking.jitter import Jitter

PERIOD_NS = 33_333_333
SIGMA = np.array([1e-3, 2e-3, 5e-4, 2e-3, 1e-3, 4e-3])  # rad, m


def smooth(count: int) -> FloatArray:
    """Return poses of a camera that sways and turns, as fast as a hand."""
    t_s = 1e-9 * PERIOD_NS * np.arange(count)
    twist = np.zeros((count, 6))
    twist[:, 1] = 0.2 * np.sin(2 * t_s)
    twist[:, 3] = 0.3 * np.sin(3 * t_s)
    twist[:, 5] = 0.5 * t_s
    return se3.exp(twist)


TOLD = np.zeros((6, 6))


def measured(T: FloatArray, period_ns: int = PERIOD_NS) -> FloatArray | None:
    jitter = Jitter()
    for n, T_odom_camera in enumerate(T):
        jitter.add(n * period_ns, T_odom_camera)
    return jitter.covariance(TOLD)


def test_a_known_jitter_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, SIGMA, (400, 6))
    covariance = measured(smooth(400) @ se3.exp(noise))
    assert covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), SIGMA, rtol=0.3)  # 60 samples
    correlation = covariance / np.outer(SIGMA, SIGMA)
    assert np.abs(correlation - np.diag(np.diag(correlation))).max() < 0.5


def test_a_smooth_motion_has_little() -> None:
    covariance = measured(smooth(60))
    assert covariance is not None
    sigma = np.sqrt(np.diag(covariance))
    assert np.degrees(sigma[:3]).max() < 0.005
    assert sigma[3:].max() < 0.0002


@pytest.mark.parametrize(
    ('count', 'period_ns'), [(4, PERIOD_NS), (60, 100_000_000)], ids=['too few', 'too slow']
)
def test_nothing_is_told_of_few_or_seldom_images(count: int, period_ns: int) -> None:
    assert measured(smooth(count), period_ns) is None


def test_a_step_between_two_motions_is_no_jitter() -> None:
    jitter, T = Jitter(), smooth(60)
    for n in range(60):
        if n == 30:
            jitter.restart()
        step = se3.exp(np.array([0.0, 0.5, 0, 1, 0, 0])) if n >= 30 else np.eye(4)
        jitter.add(n * PERIOD_NS, T[n] @ step)
    covariance = jitter.covariance(TOLD)
    assert covariance is not None
    assert np.sqrt(np.diag(covariance)).max() < 0.001


def test_what_residuals_tell_counts_to_begin_with() -> None:
    jitter, T = Jitter(), smooth(70)
    shares = []
    for n in range(70):
        jitter.add(n * PERIOD_NS, T[n])
        covariance = jitter.covariance(np.eye(6))
        shares.append(None if covariance is None else covariance[0, 0])
    assert shares[:4] == [None] * 4
    assert shares[4] == pytest.approx(5 / 6, rel=1e-3)
    assert shares[-1] == pytest.approx(5 / 65, rel=1e-3)


def test_images_at_nearly_the_same_time_tell_something_finite() -> None:
    jitter = Jitter()
    for stamp_ns, T_odom_camera in zip((0, 1, 2, 3, 200_000_000), smooth(5), strict=True):
        jitter.add(stamp_ns, T_odom_camera)
    covariance = jitter.covariance(np.eye(6))
    assert covariance is not None
    assert np.isfinite(covariance).all()
