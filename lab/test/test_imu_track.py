"""The IMU of a rendered scene measures what its camera does."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import S_PER_NS
from hoid_synth.acting.camera_path import camera_poses
from hoid_synth.config import SceneConfig
from hoid_synth.imu import GYRO_BIAS_RADPS, R_CAMERA_IMU, imu_track
from rgbd_slam.inertial.integrals import integrals
from rgbd_slam.inertial.sample_buffer import SampleBuffer, Samples


@pytest.mark.parametrize(('path', 'pace'), [('rpy', 1.0), ('xyz', 1.0), ('room', 2.0)])
def test_the_rates_turn_the_camera_from_image_to_image(path: str, pace: float) -> None:
    config = SceneConfig(path=path, num_frames=61, seed=5, pace=pace)
    track = imu_track(config)
    gyro = SampleBuffer()
    gyro.add(Samples(track.stamps_ns, track.rates_radps))
    poses = camera_poses(config, pace * np.array([config.time_s(i) for i in (0, 30, 60)]))
    for k in range(2):
        ends_ns = config.stamp_ns(30 * k), config.stamp_ns(30 * k + 30)
        found = integrals(gyro.between(*ends_ns), np.array(ends_ns), GYRO_BIAS_RADPS)
        assert found is not None
        R_imu = found.R_start_imu[-1]
        T = np.eye(4)
        T[:3, :3] = R_CAMERA_IMU @ R_imu @ R_CAMERA_IMU.T
        error = se3.log(se3.inverse(T) @ se3.inverse(poses[k]) @ poses[k + 1])[:3]
        assert np.rad2deg(np.linalg.norm(error)) < 0.1


def test_the_mean_acceleration_points_up() -> None:
    config = SceneConfig(path='xyz', num_frames=300, seed=5)
    track = imu_track(config)
    times_s = S_PER_NS * (track.stamps_ns - track.stamps_ns[0])
    R_world_camera = camera_poses(config, times_s)[:, :3, :3]
    forces = np.einsum('nij,nj->ni', R_world_camera @ R_CAMERA_IMU, track.accelerations_mps2)
    np.testing.assert_allclose(forces.mean(axis=0), [0.0, 0.0, 9.81], atol=0.1)


def test_a_track_repeats_with_its_seed() -> None:
    first, second = (imu_track(SceneConfig(num_frames=10, seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first.rates_radps, second.rates_radps)
    np.testing.assert_array_equal(first.accelerations_mps2, second.accelerations_mps2)
    assert np.all(np.diff(first.stamps_ns) == 5_000_000)


def test_the_camera_looks_down_and_is_rolled_as_configured() -> None:
    times_s = np.zeros(1)
    level, turned = (
        camera_poses(config, times_s)[0, :3, :3]
        for config in (SceneConfig(), SceneConfig(pitch_deg=30.0, roll_deg=10.0))
    )
    angles_deg = [
        np.degrees(np.arcsin([-R[2, 2], R[2, 0] / np.hypot(*R[2, :2])])) for R in (level, turned)
    ]
    np.testing.assert_allclose(np.abs(angles_deg[1] - angles_deg[0]), (30.0, 10.0))
