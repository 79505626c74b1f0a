"""Normalized squared errors of estimates with known errors."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_benchmarks.consistency import (
    Estimates,
    ReferenceNoise,
    consistency,
    reference_noise,
)
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, IntArray, Trajectory

SIGMA = np.array([1e-3, 1e-3, 2e-3, 3e-3, 2e-3, 4e-3])  # rad, m
IMAGES_NS: IntArray = 10**9 + 33_333_333 * np.arange(600, dtype=np.int64)
REFERENCE_NS: IntArray = 10_000_000 * np.arange(2300, dtype=np.int64)


def path(stamps_ns: IntArray) -> FloatArray:
    t_s = 1e-9 * stamps_ns
    twist = np.zeros((len(t_s), 6))
    twist[:, 1], twist[:, 2] = 0.2 * np.sin(6 * t_s), 0.15 * np.sin(7 * t_s)
    twist[:, 3], twist[:, 4] = 0.2 * np.sin(3 * t_s), 0.1 * t_s
    return se3.exp(twist)


def estimates(claimed: FloatArray, late_ns: int = 0) -> Estimates:
    """Return estimates with errors of `SIGMA` and covariances of `claimed` sigmas."""
    noise = np.random.default_rng(0).normal(0, SIGMA, (len(IMAGES_NS) + 1, 6))
    stamps_ns = np.r_[IMAGES_NS[0] - 33_333_333, IMAGES_NS]
    T = path(stamps_ns - late_ns) @ se3.exp(noise)
    covariance = np.tile(np.diag(claimed**2), (len(IMAGES_NS), 1, 1))
    twist = se3.log(se3.inverse(T[:-1]) @ T[1:]) * 30
    return Estimates(IMAGES_NS, T[1:], covariance, twist, 2 * covariance * 30**2)


@pytest.fixture
def truth() -> Trajectory:
    return Trajectory(REFERENCE_NS, path(REFERENCE_NS))


@pytest.mark.parametrize(('claimed', 'expected'), [(1.0, 1.0), (0.5, 4.0), (2.0, 0.25)])
def test_covariances_that_are_right_or_not(
    truth: Trajectory, claimed: float, expected: float
) -> None:
    found = consistency(estimates(claimed * SIGMA), truth)
    assert found.pose == pytest.approx(expected, rel=0.1)
    assert found.twist == pytest.approx(expected, rel=0.1)
    assert found.error_m == pytest.approx(np.sqrt(2) * np.linalg.norm(SIGMA[3:]), rel=0.1)
    assert found.sigma_m == pytest.approx(claimed * found.error_m, rel=0.1)


def test_pose_noise_and_clock_offset_of_a_reference_are_estimated() -> None:
    jitter = np.array([5e-4, 1e-3, 5e-4, 2e-3, 1e-3, 1e-3])
    noise = np.random.default_rng(1).normal(0, jitter, (len(REFERENCE_NS), 6))
    truth = Trajectory(REFERENCE_NS, path(REFERENCE_NS) @ se3.exp(noise))
    late = estimates(SIGMA, late_ns=20_000_000)
    found = reference_noise(late, truth)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), jitter, rtol=0.1)
    assert found.rotation_clock_s == pytest.approx(-0.02, abs=0.003)
    assert found.translation_clock_s == pytest.approx(-0.02, abs=0.004)


def test_the_noise_of_the_reference_is_added() -> None:
    noise = np.random.default_rng(1).normal(0, SIGMA, (len(REFERENCE_NS), 6))
    truth = Trajectory(REFERENCE_NS, path(REFERENCE_NS) @ se3.exp(noise))
    optimistic = estimates(SIGMA)
    assert consistency(optimistic, truth).pose > 1.5
    both = consistency(optimistic, truth, ReferenceNoise(np.diag(SIGMA**2), 0.0, 0.0))
    # Interpolation between two stamps halves its variance.
    assert both.pose == pytest.approx(0.85, rel=0.15)
    assert both.twist == pytest.approx(0.85, rel=0.15)


def test_a_reference_of_another_time_is_refused(truth: Trajectory) -> None:
    later = Trajectory(truth.stamps_ns + 10**12, truth.T_world_camera)
    with pytest.raises(InputError, match='overlap by less than a second'):
        consistency(estimates(SIGMA), later)
