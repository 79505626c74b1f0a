"""A gyro predicts turns and bridges a moment without images."""

from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.mounting import Mounting, kalibr_mounting, read_kalibr, snapped
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.tracking.inertial_motion import InertialMotion
from rgbd_slam.tracking.motion_sources import ExternalOdometry
from rgbd_slam.tracking.odometry import Odometry

from .shaken_imu import IMAGE_NS, START_NS, ShakenImu, pose
from .world import tracked_at


def followed(duration_s: float, seed: int = 0) -> tuple[InertialMotion, ShakenImu, int]:
    """Return a motion source that has followed tracked images, its IMU, and their number."""
    shaken = ShakenImu(seed=seed, gyro_bias=np.array([0.01, 0.0, -0.02]))
    source = InertialMotion(shaken.imu)
    num = round(duration_s * 30)
    for k in range(num):
        shaken.sample((k + 1) * IMAGE_NS + NS_PER_S // 10)
        source.start(START_NS + k * IMAGE_NS)
        source.advance(START_NS + (k + 1) * IMAGE_NS)
        T = se3.inverse(image_pose(k)) @ image_pose(k + 1)
        source.observe(T)
    shaken.sample(num * IMAGE_NS + 4 * NS_PER_S)
    source.start(START_NS + num * IMAGE_NS)
    return source, shaken, num


def rotated(R: FloatArray) -> FloatArray:
    """Return the transform (4, 4) of a rotation (3, 3)."""
    T = np.eye(4)
    T[:3, :3] = R
    return T


def image_pose(k: float) -> FloatArray:
    """Return T_world_camera (4, 4) of an image."""
    return pose(k * 1e-9 * IMAGE_NS)


def test_nothing_is_predicted_before_the_gyro_has_been_compared() -> None:
    source, *_ = followed(0.3)
    source.advance(START_NS + 10 * IMAGE_NS)
    assert source.predict() is None
    assert source.bridge() is None


def test_the_velocity_at_an_image_has_the_rate_of_the_gyro() -> None:
    observed = np.array([9.0, 9.0, 9.0, 0.1, 0.2, 0.3])
    for unknown in (None, followed(0.3)[0]):
        odometry = Odometry(Atlas(1.2, 8), gyro=unknown)
        odometry.twist = observed
        assert odometry.twist_at(START_NS + IMAGE_NS) is observed
    source, _, num = followed(6.0)
    odometry = Odometry(Atlas(1.2, 8), gyro=source)
    odometry.twist = observed
    twist = odometry.twist_at(START_NS + num * IMAGE_NS)
    around = se3.inverse(image_pose(num - 0.1)) @ image_pose(num + 0.1)
    rate_radps = se3.log(around)[:3] / (0.2e-9 * IMAGE_NS)
    assert np.linalg.norm(rate_radps) > 0.2
    np.testing.assert_allclose(twist[:3], -rate_radps, atol=0.05)
    np.testing.assert_array_equal(twist[3:], [0.1, 0.2, 0.3])


def test_a_prior_of_the_rotation_is_near_the_truth_and_can_be_switched_off() -> None:
    source, shaken, num = followed(6.0)
    source.advance(START_NS + (num + 1) * IMAGE_NS)
    prior = source.rotation_prior()
    assert prior is not None
    true = se3.inverse(image_pose(num)) @ image_pose(num + 1)
    turn = se3.log(se3.inverse(true) @ rotated(prior.R_first_second))[:3]
    assert np.rad2deg(np.linalg.norm(turn)) < 0.1
    assert 0.2 < np.rad2deg(prior.sigma_rad) < 0.5
    odometry = Odometry(Atlas(1.2, 8), gyro=source)
    assert odometry.prior() is None  # nothing has been tracked
    odometry.last = tracked_at(image_pose(num), START_NS)
    found = odometry.prior()
    assert found is not None
    error = se3.log(found.T_camera_map @ image_pose(num + 1))[:3]
    assert np.rad2deg(np.linalg.norm(error)) < 0.1
    off = InertialMotion(Imu(ImuConfig(prior=False)))
    assert off.rotation_prior() is None
    source.start(START_NS + (num + 9) * IMAGE_NS)  # another frame than the last one that was added
    source.advance(START_NS + (num + 10) * IMAGE_NS)
    assert source.rotation_prior() is None
    assert shaken.imu.trust.fault is None


def test_the_next_image_is_predicted() -> None:
    source, _, num = followed(4.0)
    source.advance(START_NS + (num + 1) * IMAGE_NS)
    T_camera_last = source.predict()
    assert T_camera_last is not None
    error = se3.log(T_camera_last @ se3.inverse(image_pose(num)) @ image_pose(num + 1))
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 5e-3


@pytest.mark.slow
def test_a_second_without_images_is_bridged_with_an_honest_covariance() -> None:
    ratios, angles_deg, distances_m = [], [], []
    for seed in range(8):
        source, _, num = followed(4.0 + 0.31 * seed, seed)
        source.advance(START_NS + (num + 30) * IMAGE_NS)
        bridge = source.bridge()
        assert bridge is not None
        assert bridge.is_short
        true = se3.inverse(image_pose(num)) @ image_pose(num + 30)
        error = se3.log(se3.inverse(true) @ bridge.T_last_camera)
        angles_deg.append(np.rad2deg(np.linalg.norm(error[:3])))
        distances_m.append(np.linalg.norm(bridge.T_last_camera[:3, 3] - true[:3, 3]))
        sigma_m = np.sqrt(np.trace(bridge.covariance[3:, 3:]))
        ratios.append(distances_m[-1] / sigma_m)
    assert np.median(angles_deg) < 1.0
    assert np.median(distances_m) < 0.3  # the camera swings by 0.3 m in this time
    assert 0.3 < np.median(ratios) < 1.7


def test_longer_losses_are_not_bridged() -> None:
    source, _, num = followed(4.0)
    source.advance(START_NS + (num + 50) * IMAGE_NS)
    assert source.bridge() is None
    assert source.predict() is not None  # but the turn is still known


def test_a_pose_with_few_inliers_is_accepted_where_the_gyro_agrees() -> None:
    source, _, num = followed(4.0)
    odometry = Odometry(Atlas(1.2, 8), gyro=source)
    T_before, T_now = image_pose(num), image_pose(num + 1)
    enough = TrackingConfig.min_inliers
    assert odometry.min_inliers(se3.inverse(T_now)) == enough  # nothing has been tracked
    odometry.last = tracked_at(T_before, START_NS)
    source.start(START_NS + num * IMAGE_NS)
    odometry.follow(START_NS + (num + 1) * IMAGE_NS)
    turned = se3.exp(np.array([0.0, np.deg2rad(2.0), 0, 0, 0, 0])) @ se3.inverse(T_now)
    moved = se3.exp(np.array([0, 0, 0, 0.1, 0, 0])) @ se3.inverse(T_now)
    assert odometry.min_inliers(se3.inverse(T_now)) == 12
    assert odometry.min_inliers(turned) == odometry.min_inliers(moved) == enough
    later = num + 7  # 0.23 s after the last tracked image
    odometry.follow(START_NS + later * IMAGE_NS)
    bridge = source.bridge()
    assert bridge is not None
    T_camera_map = se3.inverse(T_before @ bridge.T_last_camera)
    assert odometry.min_inliers(T_camera_map) == enough
    without = Odometry(Atlas(1.2, 8))
    without.last = tracked_at(T_before, START_NS)
    assert without.min_inliers(se3.inverse(T_now)) == enough


def test_wheels_bridge_before_the_gyro() -> None:
    source, _, num = followed(4.0)
    step = se3.exp(np.array([0, 0, 0, 0.0, 0.0, 0.1]))
    wheels = ExternalOdometry(lambda *_: step)
    for sources, note in (([wheels], 'the wheel odometry'), ([], 'the gyro')):
        odometry = Odometry(Atlas(1.2, 8), source, sources)
        odometry.restart_from(tracked_at(np.eye(4), START_NS + num * IMAGE_NS))
        odometry.follow(START_NS + (num + 1) * IMAGE_NS)
        bridge = odometry.bridge()
        assert bridge is not None
        assert note in bridge.note
        assert bridge.is_short == (not sources)


def test_a_mounting_between_parallel_axes_is_recognized() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    off = se3.exp(np.deg2rad([2.0, -1.0, 1.0, 0, 0, 0]))[:3, :3]
    np.testing.assert_array_equal(snapped(off @ quarter, 0.0), quarter)
    odd = se3.exp(np.deg2rad([20.0, 0, 0, 0, 0, 0]))[:3, :3]
    np.testing.assert_array_equal(snapped(odd, 0.01), odd)


KALIBR = """cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.01]
  - [0.0, 0.0, -1.0, 0.02]
  - [1.0, 0.0, 0.0, 0.03]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -0.0071
"""


def test_a_calibration_of_kalibr_in_the_home_folder_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'camchain-imucam.yaml').write_text(KALIBR, encoding='utf-8')
    assert kalibr_mounting(ImuConfig()) is None
    mounting = kalibr_mounting(ImuConfig(calibration='~/camchain-imucam.yaml'))
    assert mounting is not None
    np.testing.assert_allclose(mounting.R_camera_imu, [[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    assert mounting.offset_s == -0.0071
    assert mounting.sigma_rad < Mounting(mounting.R_camera_imu).sigma_rad


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('cam0', 'cam1', 'expected the entry cam0'),
        ('T_cam_imu', 'T_imu_cam', 'T_cam_imu is missing'),
        ('[1.0, 0.0, 0.0, 0.03]', '[1.0, 0.5, 0.0, 0.03]', 'is no rotation'),
        ('-0.0071', 'soon', 'is not a time in seconds'),
        ('-0.0071', '1.0e+300', 'is not a time in seconds'),
    ],
)
def test_a_damaged_calibration_is_refused_by_its_name(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / 'chain.yaml'
    path.write_text(KALIBR.replace(old, new), encoding='utf-8')
    with pytest.raises(InputError, match=rf'chain\.yaml: .*{message}'):
        read_kalibr(path)
