"""A filtered attitude follows the gyro where single tracked rotations are wrong."""

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.inertial.attitude_filter import AttitudeFilter

STEP_S = 1 / 30
BIAS_SIGMA_RADPS = 0.005


def rotation(vector_rad: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) about a vector."""
    return np.asarray(se3.exp(np.append(vector_rad, np.zeros(3)))[:3, :3])


def angle_deg(R: FloatArray) -> float:
    """Return the angle of a rotation (3, 3)."""
    return float(np.rad2deg(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))


def errors_deg(noise_rad: float, bias_radps: float) -> tuple[float, float, float]:
    """Return the errors of filtered and of tracked attitudes, and the expected one, as RMS."""
    rng = np.random.default_rng(7)
    attitude, turn = AttitudeFilter(), rotation(np.array([0.02, -0.01, 0.015]))
    R_true = R_tracked = np.eye(3)
    filtered, tracked, expected = [], [], []
    for k in range(150):
        R_true = R_true @ turn
        R_next = R_true @ rotation(rng.normal(0, noise_rad, 3))
        gyro = turn @ rotation(np.array([bias_radps * STEP_S, 0.0, 0.0]))
        attitude.add(gyro, R_tracked.T @ R_next, STEP_S, bias_radps)
        R_tracked = R_next
        if k >= 30:
            assert attitude.R_tracked_filtered is not None
            filtered.append(angle_deg(R_true.T @ R_tracked @ attitude.R_tracked_filtered))
            tracked.append(angle_deg(R_true.T @ R_tracked))
            expected.append(attitude.sigma_rad)
    filtered_deg, tracked_deg = np.sqrt(np.square([filtered, tracked]).mean(1)).tolist()
    return filtered_deg, tracked_deg, float(np.rad2deg(np.mean(expected)))


def test_a_filtered_attitude_is_closer_than_tracked_ones() -> None:
    filtered, tracked, expected = errors_deg(np.deg2rad(0.6), 0.005)
    assert filtered < 0.5 * tracked
    assert filtered / np.sqrt(3) < expected < tracked


def test_one_wrong_rotation_hardly_changes_the_attitude() -> None:
    attitude, still = AttitudeFilter(), np.eye(3)
    for _ in range(30):
        attitude.add(still, still, STEP_S, BIAS_SIGMA_RADPS)
    wrong = rotation(np.array([0.0, np.deg2rad(1.5), 0.0]))
    attitude.add(still, wrong, STEP_S, BIAS_SIGMA_RADPS)
    assert attitude.R_tracked_filtered is not None
    # The correction takes most of the wrong rotation back.
    np.testing.assert_allclose(
        np.rad2deg(se3.log(_pose(attitude.R_tracked_filtered))[:3]), [0.0, -1.43, 0.0], atol=1e-3
    )


def test_rotations_that_are_wrong_together_do_not_take_the_attitude_with_them() -> None:
    """Before a bare wall, tracked rotations drift by 10 degrees in 1.5 s, the gyro does not."""
    rng = np.random.default_rng(3)
    attitude, still = AttitudeFilter(), np.eye(3)
    drift = rotation(np.deg2rad([10 / 45, 0.0, 0.0]))
    for k in range(345):
        step = rotation(rng.normal(0, np.deg2rad(0.15), 3)) @ (drift if k >= 300 else still)
        attitude.add(still, step, STEP_S, 0.003)
    assert attitude.R_tracked_filtered is not None
    # Relative to the last image, so that -10 degrees are no error of the attitude.
    correction = se3.log(_pose(attitude.R_tracked_filtered))[:3]
    assert np.rad2deg(correction[0]) < -6.5


def test_a_gap_in_the_samples_restarts_the_filter() -> None:
    attitude = AttitudeFilter()
    for _ in range(10):
        attitude.add(np.eye(3), np.eye(3), STEP_S, BIAS_SIGMA_RADPS)
    assert attitude.R_tracked_filtered is not None
    attitude.add(None, np.eye(3), STEP_S, BIAS_SIGMA_RADPS)
    assert attitude.R_tracked_filtered is None


def _pose(R: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = R
    return T
