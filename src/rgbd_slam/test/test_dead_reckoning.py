"""An accelerometer that agrees with the images continues the position where they fail."""

from collections.abc import Callable

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.integrals import integrals
from rgbd_slam.inertial.rotations import rotation_vector
from rgbd_slam.inertial.sample_buffer import SampleBuffer, Samples
from rgbd_slam.tracking.inertial_motion import InertialMotion
from rgbd_slam.tracking.motion_sources import BridgedMotion

from .shaken_imu import IMAGE_NS, POSE_NOISE_M, POSE_NOISE_RAD, START_NS, ShakenImu, pose

NUM_TRACKED, NUM_LOST = 150, 30
OFF = ImuConfig(integrate=False)
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def image_pose(k: int) -> FloatArray:
    """Return T_world_camera (4, 4) of an image."""
    return pose(k * 1e-9 * IMAGE_NS)


def shaken_imu(
    seed: int = 0,
    config: ImuConfig | None = None,
    distort: Callable[[FloatArray], FloatArray] | None = None,
) -> ShakenImu:
    """Return an IMU of which neither the mounting nor the offset nor the bias is told."""
    bias = np.array([0.01, 0.0, -0.02])
    return ShakenImu(
        AXES, 0.02, bias, distort_force=distort, accelerometer=True, seed=seed, config=config
    )


def track(
    source: InertialMotion, shaken: ShakenImu, num_images: int, seed: int = 0, first: int = 0
) -> None:
    """Let the source observe images from the first one on, with noise."""
    rng, before = np.random.default_rng(seed), image_pose(first)
    for k in range(first, num_images):
        shaken.sample((k + 1) * IMAGE_NS + NS_PER_S // 10)
        noise = np.r_[rng.normal(0, POSE_NOISE_RAD, 3), rng.normal(0, POSE_NOISE_M, 3)]
        now = image_pose(k + 1) @ se3.exp(noise)
        source.start(START_NS + k * IMAGE_NS)
        source.advance(START_NS + (k + 1) * IMAGE_NS)
        source.observe(se3.inverse(before) @ now)
        before = now


def bridged(
    seed: int = 0,
    num_tracked: int = NUM_TRACKED,
    num_lost: int = NUM_LOST,
    config: ImuConfig | None = None,
    distort: Callable[[FloatArray], FloatArray] | None = None,
) -> BridgedMotion:
    """Return the predicted motion over `num_lost` images that are not tracked.

    Before them, `num_tracked` images are tracked with noise.
    """
    shaken = shaken_imu(seed, config, distort)
    source = InertialMotion(shaken.imu)
    track(source, shaken, num_tracked, seed)
    shaken.sample((num_tracked + num_lost) * IMAGE_NS + NS_PER_S // 10)
    source.start(START_NS + num_tracked * IMAGE_NS)
    for k in range(num_lost):
        source.advance(START_NS + (num_tracked + k + 1) * IMAGE_NS)
    bridge = source.bridge()
    assert bridge is not None
    T_camera_last = source.predict()
    assert T_camera_last is not None
    np.testing.assert_allclose(T_camera_last @ bridge.T_last_camera, np.eye(4), atol=1e-12)
    return bridge


def error_m(bridge: BridgedMotion, num_tracked: int = NUM_TRACKED) -> float:
    """Return the error of a bridged position over 30 images."""
    true = se3.inverse(image_pose(num_tracked)) @ image_pose(num_tracked + NUM_LOST)
    return float(np.linalg.norm(bridge.T_last_camera[:3, 3] - true[:3, 3]))


def test_a_constant_force_on_a_turning_imu_is_integrated_exactly() -> None:
    """The IMU turns by 1 rad/s about z; the force is constant along the axes of the origin."""
    stamps_ns = np.arange(-NS_PER_S, NS_PER_S + 1, NS_PER_S // 200)
    bias_radps, bias_mps2 = np.array([0.02, 0.0, 0.01]), np.array([0.1, 0.0, -0.1])
    force = np.array([1.0, 2.0, 9.81])
    turns = np.zeros((len(stamps_ns), 6))
    turns[:, 2] = 1e-9 * stamps_ns
    R_origin_imu = se3.exp(turns)[:, :3, :3]
    gyro, accelerometer = SampleBuffer(), SampleBuffer()
    rates = np.tile(np.array([0.0, 0.0, 1.0]) + bias_radps, (len(stamps_ns), 1))
    gyro.add(Samples(stamps_ns, rates))
    accelerometer.add(Samples(stamps_ns, force @ R_origin_imu + bias_mps2))
    times_s = np.array([-1.0, -0.5, 0.25, 1.0])
    at_ns = np.rint(1e9 * times_s).astype(np.int64)
    samples = [sensor.between(-NS_PER_S, NS_PER_S) for sensor in (gyro, accelerometer)]
    found = integrals(samples[0], at_ns, bias_radps, samples[1], bias_mps2)
    assert found is not None
    elapsed_s = (times_s + 1.0)[:, None]
    force_start = R_origin_imu[0].T @ force
    np.testing.assert_allclose(found.velocity_mps, elapsed_s * force_start, atol=1e-4)
    np.testing.assert_allclose(found.moved_m, 0.5 * elapsed_s**2 * force_start, atol=1e-4)
    turns_rad = rotation_vector(found.R_start_imu)
    np.testing.assert_allclose(turns_rad, elapsed_s * [0.0, 0.0, 1.0], atol=1e-9)
    later_ns = np.array([0, NS_PER_S + NS_PER_S // 10])  # 0.1 s without samples at the end
    assert integrals(samples[0], later_ns, bias_radps, samples[1], bias_mps2) is None


@pytest.mark.slow
def test_a_second_is_bridged_to_centimeters_with_an_honest_covariance() -> None:
    errors_m, ratios = [], []
    for seed in range(16):
        bridge = bridged(seed, NUM_TRACKED + 10 * seed)
        errors_m.append(error_m(bridge, NUM_TRACKED + 10 * seed))
        ratios.append(errors_m[-1] / np.sqrt(np.trace(bridge.covariance[3:, 3:])))
    assert np.median(errors_m) < 0.03  # 0.1 to 0.3 m by the decaying velocity
    assert max(errors_m) < 0.06
    assert 0.2 < np.median(ratios) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    'distort',
    [
        lambda forces: np.tile([0.0, 0.0, 9.81], (len(forces), 1)),
        lambda forces: forces * np.array([1.0, -1.0, 1.0]),
        lambda forces: forces[:, [2, 0, 1]],
        lambda forces: forces / 9.81,
        lambda forces: np.clip(forces, -7.0, 7.0),
    ],
    ids=['stuck', 'mirrored', 'permuted', 'g', 'saturated'],
)
def test_a_faulty_accelerometer_is_not_integrated(
    distort: Callable[[FloatArray], FloatArray],
) -> None:
    faulty, without = bridged(distort=distort), bridged(distort=distort, config=OFF)
    np.testing.assert_array_equal(faulty.T_last_camera, without.T_last_camera)
    np.testing.assert_array_equal(faulty.covariance, without.covariance)


def test_the_accelerometer_can_be_switched_off() -> None:
    on, off = bridged(), bridged(config=OFF)
    assert error_m(on) < 0.05
    assert error_m(off) > 0.1
    np.testing.assert_array_equal(on.T_last_camera[:3, :3], off.T_last_camera[:3, :3])


@pytest.mark.parametrize(('num_tracked', 'num_lost'), [(150, 2), (60, 30)])
def test_a_short_step_or_a_short_past_uses_the_last_velocity(
    num_tracked: int, num_lost: int
) -> None:
    """Up to 0.1 s, and before 2.3 s have been tracked, nothing is integrated."""
    given = bridged(0, num_tracked, num_lost)
    without = bridged(0, num_tracked, num_lost, OFF)
    np.testing.assert_array_equal(given.T_last_camera, without.T_last_camera)


@pytest.mark.parametrize('config', [ImuConfig(), OFF], ids=['integrated', 'not integrated'])
def test_an_accelerometer_that_agrees_with_the_tracked_motion_confirms_up(
    config: ImuConfig,
) -> None:
    shaken = shaken_imu(config=config)
    source = InertialMotion(shaken.imu)
    track(source, shaken, 100)
    assert shaken.imu.up is not None
    assert shaken.imu.confirmed_up is shaken.imu.up
    for error, confirmed in ((2.1, None), (None, shaken.imu.up), (1.9, shaken.imu.up)):
        shaken.imu.trust.compare_positions(error)
        assert shaken.imu.confirmed_up is confirmed


@pytest.mark.slow
def test_an_accelerometer_that_contradicts_the_tracked_motion_confirms_no_up() -> None:
    """A bias of 4 m/s^2 turns the measured direction of gravity by about 20 degrees.

    The standard deviation of the fit stays below 1 degree, as if there were no fault.
    """
    bias_mps2 = np.array([4.0, 0.0, 0.0])
    shaken = shaken_imu(distort=lambda forces: forces + bias_mps2)
    track(InertialMotion(shaken.imu), shaken, 480)
    assert shaken.imu.up is not None
    assert np.rad2deg(shaken.imu.up.sigma_rad) < 1.0
    assert shaken.imu.confirmed_up is None
    (problem,) = [news.text for news in shaken.imu.trust.take_news() if news.is_problem]
    assert problem == (
        'imu: the accelerometer is left out, because it does not agree with the tracked motion; '
        'check its axes and stamps, or turn the camera more slowly'
    )


@pytest.mark.parametrize('images_before', [6, 9, 15])  # of which three have samples already
def test_a_bridge_by_a_gyro_that_has_just_gone_wrong_says_how_uncertain_it_is(
    images_before: int,
) -> None:
    """The bias of the gyro jumps by 0.2 rad/s shortly before the lens is covered for 1 s."""
    shaken = shaken_imu()
    source = InertialMotion(shaken.imu)
    track(source, shaken, NUM_TRACKED - images_before)
    shaken.distort = lambda rates: rates + 0.2
    track(source, shaken, NUM_TRACKED, first=NUM_TRACKED - images_before)
    shaken.sample((NUM_TRACKED + NUM_LOST) * IMAGE_NS + NS_PER_S // 10)
    source.start(START_NS + NUM_TRACKED * IMAGE_NS)
    source.advance(START_NS + (NUM_TRACKED + NUM_LOST) * IMAGE_NS)
    bridge = source.bridge()
    assert bridge is not None
    true = se3.inverse(image_pose(NUM_TRACKED)) @ image_pose(NUM_TRACKED + NUM_LOST)
    error = se3.log(se3.inverse(true) @ bridge.T_last_camera)
    sigmas = np.sqrt(np.diag(bridge.covariance))
    assert np.linalg.norm(error[3:]) > 0.2  # without this fault it is 0.02
    assert np.linalg.norm(error[:3]) < 3 * np.linalg.norm(sigmas[:3])
    assert np.linalg.norm(error[3:]) < 3 * np.linalg.norm(sigmas[3:])
