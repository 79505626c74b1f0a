"""Changes of IMU samples, the errors of a run's calibration, and their table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from hoid_bags.imu_recording import ImuRecording
from hoid_bags.sequence import Sequence
from hoid_benchmarks.commands import add_bench_arguments, bench_command
from hoid_benchmarks.jobs.inertial import InertialErrors
from hoid_benchmarks.jobs.results import Result, write_result
from hoid_benchmarks.plan.imu_changes import changed_imu, late_ms, turned
from hoid_benchmarks.plan.plan import Experiment, Job, Perturbation, load_plan
from hoid_benchmarks.report.views import make_table
from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import Trajectory
from hoid_synth.imu import R_CAMERA_IMU
from rgbd_slam.inertial.report import ImuReport
from rgbd_slam.inertial.rotations import rotation_vector
from rgbd_slam.robot_frames import RobotPose

SECONDS = np.arange(0, 4, 0.01)
STAMPS_NS = np.rint(1e9 * SECONDS).astype(np.int64)
VALUES = np.stack([np.sin(SECONDS), 3 * np.cos(SECONDS), 9.81 + 0 * SECONDS], 1)
ROTATION_DEG = tuple(np.rad2deg(rotation_vector(R_CAMERA_IMU)).tolist())
BOTH = ImuRecording(NumberTable(STAMPS_NS, VALUES), NumberTable(STAMPS_NS, 2 * VALUES))


def changed(change: str, seed: int = 0) -> tuple[NumberTable, NumberTable]:
    found = changed_imu(BOTH, change, seed)
    assert found is not None
    assert found.rates is not None
    assert found.accelerations is not None
    return found.rates, found.accelerations


def test_a_change_concerns_the_sensor_that_it_names() -> None:
    rates, accelerations = changed('gyro in degrees, accelerometer in g')
    np.testing.assert_allclose(rates.values, np.rad2deg(VALUES))
    np.testing.assert_allclose(accelerations.values, 2 * VALUES / 9.81)
    rates, accelerations = changed('gyro stuck')
    assert (rates.values == VALUES[0]).all()
    np.testing.assert_array_equal(accelerations.values, 2 * VALUES)
    assert changed('') == (BOTH.rates, BOTH.accelerations)
    assert changed_imu(BOTH, 'none', 0) is None


def test_faults_of_samples() -> None:
    later = changed('gyro stuck later')[0].values
    np.testing.assert_array_equal(later[:200], VALUES[:200])
    assert (later[202:] == later[201]).all()
    clipped = changed('imu saturated')
    assert [table.values.max() for table in clipped] == [2.0, 8.0]
    gaps_s = 1e-9 * changed('gyro gaps')[0].stamps_ns
    assert len(gaps_s) == 280
    assert np.diff(gaps_s).max() == pytest.approx(0.31)
    np.testing.assert_array_equal(changed('gyro mirrored')[0].values, VALUES * [1, -1, 1])
    np.testing.assert_array_equal(changed('gyro axes permuted')[0].values, VALUES[:, [2, 0, 1]])


def test_a_turned_and_late_imu() -> None:
    change = 'imu turned, imu late 70 ms'
    R = turned(change, 3)
    assert late_ms(change) == 70
    for table, before in zip(changed(change, 3), (VALUES, 2 * VALUES), strict=True):
        np.testing.assert_allclose(table.values @ R, before, atol=1e-12)
        np.testing.assert_array_equal(table.stamps_ns, STAMPS_NS + 70_000_000)
    assert np.linalg.norm(R - turned(change, 4)) > 0.1
    np.testing.assert_array_equal(turned('gyro stuck', 3), np.eye(3))


def test_a_fault_in_the_middle_and_a_clock_that_steps() -> None:
    biased = changed('gyro biased in the middle')[0].values - VALUES
    assert (biased[:170] == 0).all()
    np.testing.assert_allclose(biased[170:], 0.2)
    spikes = changed('accelerometer spikes')[1].values
    assert (spikes[::100] == 150.0).all()
    np.testing.assert_array_equal(spikes[1:100], 2 * VALUES[1:100])
    turned_by_20 = changed('accelerometer turned by 20 degrees')[1].values
    R = np.linalg.lstsq(2 * VALUES, turned_by_20)[0].T
    assert np.rad2deg(np.linalg.norm(rotation_vector(R))) == pytest.approx(20.0)
    for change, sign in (
        ('gyro clock steps by an hour', 1),
        ('gyro clock steps back by an hour', -1),
    ):
        stamps_ns = changed(change)[0].stamps_ns
        assert (np.diff(stamps_ns) > 0).all()
        assert np.ptp(stamps_ns) == pytest.approx(3.6e12, abs=4e9)
        assert np.count_nonzero(np.abs(stamps_ns - sign * 3.6e12) < 4e9) == 199


@pytest.mark.parametrize('change', ['gyro melted', 'compass stuck', 'stuck'])
def test_an_unknown_change_is_refused(change: str) -> None:
    with pytest.raises(ConfigError, match=f'no change "{change}"'):
        changed_imu(BOTH, change, 0)


class Recording:
    """A recording of a camera that moves along x and y, and its true poses."""

    def __init__(self, num_images: int) -> None:
        self.stamps_ns = 100_000_000 * np.arange(num_images)
        T_world_camera = np.tile(np.eye(4), (num_images, 1, 1))
        T_world_camera[:, 0, 3] = 0.1 * np.arange(num_images)
        T_world_camera[:, 1, 3] = np.sin(np.arange(num_images))
        self.ground_truth = Trajectory(self.stamps_ns, T_world_camera)


def errors_of(job: Job, tilt_deg: float, from_image: int, jump_m: float) -> dict[str, float]:
    """Return the errors of a run whose map is tilted up to an image, where the pose jumps."""
    recording = Recording(80)
    errors = InertialErrors(job, cast(Sequence, recording), 80)
    tilt = se3.exp(np.array([np.deg2rad(tilt_deg), 0, 0, 0, 0, 0]))
    tilted = np.array([tilt, np.eye(4)])
    for k, T_world_camera in enumerate(recording.ground_truth.T_world_camera):
        T_map_camera = tilted[int(k >= from_image)] @ T_world_camera
        T_map_camera[0, 3] += jump_m * (k >= from_image)
        pose = RobotPose(np.eye(4), T_map_camera, np.eye(6), np.zeros(6), np.eye(6))
        report = ImuReport(71.5, 1.0, ROTATION_DEG, 1.0, (0.012, -0.015, 0.013))
        errors.add(int(recording.stamps_ns[k]), pose, report)
    return errors.summary(recording.ground_truth)


def test_errors_of_level_calibration_and_bridge() -> None:
    changes = Perturbation(imu='imu late 70 ms', black_images=10)
    job = Job('hand-1_imu', 'none', '', 0, perturbation=changes)
    found = errors_of(job, 3.0, 30, 0.0)
    assert found['tilt_2s_deg'] == pytest.approx(3.0)
    assert found['tilt_2s_to_last_deg'] == pytest.approx(3.0)
    assert found['tilt_5s_deg'] == pytest.approx(0.0, abs=1e-6)
    assert found['offset_20s_ms'] == pytest.approx(1.5)
    assert found['rotation_20s_deg'] == pytest.approx(0.0, abs=1e-2)
    assert found['bias_5s_radps'] == pytest.approx(0.003)
    assert [found[name] for name in ('bridged', 'bridge_m')] == pytest.approx([1.0, 0.0])
    assert found['seen_m'] == pytest.approx(0.0, abs=1e-6)
    assert (found['reported'], found['gyro_used']) == (0.0, 0.0)
    jumped = errors_of(job, 0.0, 45, 0.2)
    assert [jumped[name] for name in ('bridge_m', 'after_m')] == pytest.approx([0.2, 0.2])
    assert jumped['bridge_sigmas'] == pytest.approx(0.2 / np.sqrt(3))


def result(seed: int, imu: str, ate_m: float, **errors: float) -> Result:
    job = Job('turn-1_imu', 'none', '', seed, perturbation=Perturbation(imu=imu))
    return Result(job, {'ate_rmse_m': ate_m, 'coverage': 1.0, 'imu_errors': errors})


def test_the_table_compares_each_run_with_the_same_run_without_an_imu() -> None:
    results = [
        result(0, 'none', 0.1),
        result(1, 'none', 0.2),
        result(0, 'gyro stuck', 0.11, tilt_2s_deg=1.0),
        result(1, 'gyro stuck', 0.1, tilt_2s_deg=2.0),
    ]
    jobs = tuple(r.job for r in results)
    table = make_table(Experiment('a', 'A', 'imu', '', '', '', jobs), results)
    rows = [dict(zip(table.columns, (c.text for c in row), strict=True)) for row in table.rows]
    assert [row['variant'] for row in rows] == ['imu=none', 'imu=gyro stuck']
    assert [row['relative to no IMU'] for row in rows] == ['1.00 [1.00-1.00]', '0.80 [0.50-1.10]']
    assert [row['tilt after 2 s [deg]'] for row in rows] == ['-', '1.5 [1.0-2.0]']


def test_the_table_of_a_chosen_experiment_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for job in load_plan('hand_held').only(['imu_level']).jobs():
        summary = {'ate_rmse_m': 0.01, 'imu_errors': {'tilt_5s_deg': 0.5}}
        write_result(tmp_path / 'hand_held', Result(job, summary))
    parser = argparse.ArgumentParser()
    add_bench_arguments(parser)
    words = ['hand_held', '--only', 'imu_level', '--report', '--out', str(tmp_path)]
    bench_command(parser.parse_args(words))
    printed = capsys.readouterr().out
    assert 'A level map by the accelerometer' in printed
    assert '| - | none | 1 | 0.0100 | - | 0.5 |' in printed
    assert 'Faults of an IMU' not in printed
