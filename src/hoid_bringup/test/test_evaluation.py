"""The evaluation of a trajectory with known errors returns exactly these errors."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core.metrics import RPE, PoseRelation, Unit
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given
from hypothesis import strategies as st

from hoid_bringup.evaluate import evaluation
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, Trajectory

START_NS = 1_305_031_098_000_000_000
PERIOD_NS = 40_000_000


def wavy(n: int = 100) -> Trajectory:
    s = np.linspace(0, 4, n)
    rotation = [0.2 * np.sin(s), 0.1 * s, 0.1 * np.cos(s)]
    twist = np.stack([*rotation, s, np.sin(2 * s), np.cos(s)], axis=1)
    return Trajectory(START_NS + PERIOD_NS * np.arange(n), se3.exp(twist))


def moved(trajectory: Trajectory, T: FloatArray) -> Trajectory:
    return Trajectory(trajectory.stamps_ns, T @ trajectory.T_world_camera)


@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_a_rigid_motion_of_the_truth_has_no_error(twist: list[float]) -> None:
    truth = wavy()
    result = evaluation.evaluate(moved(truth, se3.exp(np.array(twist))), truth)
    assert result.ate_rmse_m < 1e-9
    assert result.rpe_trans_1s_rmse_m is not None
    assert result.rpe_trans_1s_rmse_m < 1e-9
    assert result.num_pairs == 100
    assert result.coverage is None


def test_ate_of_known_offsets() -> None:
    """Corners of a cross move outward by 1 cm, which no rigid motion can compensate."""
    corners = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    T_true, T_estimate = np.tile(np.eye(4), (4, 1, 1)), np.tile(np.eye(4), (4, 1, 1))
    T_true[:, :3, 3], T_estimate[:, :3, 3] = corners, 1.01 * corners
    stamps = START_NS + PERIOD_NS * np.arange(4)
    result = evaluation.evaluate(Trajectory(stamps, T_estimate), Trajectory(stamps, T_true))
    assert result.ate_rmse_m == pytest.approx(0.01, abs=1e-9)
    assert result.ate_max_m == pytest.approx(0.01, abs=1e-9)


def test_rpe_of_a_constant_drift() -> None:
    """A drift of 2 mm per frame along x is 50 mm in the 25 frames of a second."""
    n = 60
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 1, 3], T[:, 2, 3] = np.sin(np.arange(n) / 9), np.cos(np.arange(n) / 5)
    drifting = T.copy()
    drifting[:, 0, 3] = 0.002 * np.arange(n)
    stamps = START_NS + PERIOD_NS * np.arange(n)
    result = evaluation.evaluate(Trajectory(stamps, drifting), Trajectory(stamps, T))
    assert result.rpe_trans_1s_rmse_m == pytest.approx(0.05, abs=1e-3)


def test_rpe_equals_evo_on_a_regular_trajectory() -> None:
    truth = wavy()
    rng = np.random.default_rng(0)
    noise = se3.exp(0.01 * rng.standard_normal((100, 6)))
    noisy = Trajectory(truth.stamps_ns, truth.T_world_camera @ noise)
    aligned = evaluation.align(noisy, truth)
    ours_m, ours_deg = evaluation.relative_errors(aligned)
    pair = [
        PoseTrajectory3D(poses_se3=list(T), timestamps=aligned.stamps_ns / 1e9)
        for T in (aligned.T_world_camera_true, aligned.T_world_camera)
    ]
    for relation, ours in (
        (PoseRelation.translation_part, ours_m),
        (PoseRelation.rotation_angle_deg, ours_deg),
    ):
        rpe = RPE(relation, delta=25, delta_unit=Unit.frames, all_pairs=True)
        rpe.process_data((pair[0], pair[1]))
        np.testing.assert_allclose(ours, rpe.error, atol=1e-9)


def test_coverage_is_the_share_of_frames_with_a_pose() -> None:
    truth = wavy()
    half = Trajectory(truth.stamps_ns[:50], truth.T_world_camera[:50])
    assert evaluation.evaluate(half, truth, frames_total=100).coverage == 0.5


def test_without_poses_a_second_apart_there_is_no_relative_error() -> None:
    truth = wavy()
    short = Trajectory(truth.stamps_ns[:10], truth.T_world_camera[:10])
    result = evaluation.evaluate(short, truth)
    assert result.rpe_trans_1s_rmse_m is None
    assert result.ate_rmse_m < 1e-9


def test_ground_truth_of_another_recording_is_refused() -> None:
    truth = wavy()
    later = Trajectory(truth.stamps_ns + 10**12, truth.T_world_camera)
    with pytest.raises(InputError, match='of the same recording'):
        evaluation.align(later, truth)
    with pytest.raises(InputError, match='2 poses'):
        evaluation.align(Trajectory(truth.stamps_ns[:2], truth.T_world_camera[:2]), truth)
