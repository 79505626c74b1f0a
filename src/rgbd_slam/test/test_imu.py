"""An IMU is calibrated by the tracked motion, and left out while it contradicts it."""

from collections.abc import Callable

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.integrals import integrals
from rgbd_slam.inertial.mounting import Mounting
from rgbd_slam.inertial.report import ImuReport, report_of
from rgbd_slam.inertial.sample_buffer import SampleBuffer, Samples
from rgbd_slam.inertial.trust import GyroFault

from .shaken_imu import IMAGE_NS, START_NS, UP_WORLD, ShakenImu, pose

BIAS: FloatArray = np.array([0.015, -0.02, 0.012])
AXES: FloatArray = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
ODD: FloatArray = se3.exp(np.array([0.3, -0.9, 0.5, 0, 0, 0]))[:3, :3]


def angle_deg(R: FloatArray) -> float:
    """Return the angle of a rotation (3, 3)."""
    return float(np.rad2deg(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))


def spinning(rates: FloatArray, period_ns: int = 5_000_000) -> SampleBuffer:
    """Return a buffer with samples (N, 3) from the stamp 0 on."""
    gyro = SampleBuffer()
    gyro.add(Samples(np.arange(len(rates)) * period_ns, rates))
    return gyro


def turned(
    gyro: SampleBuffer, first_ns: int, second_ns: int, bias_radps: FloatArray
) -> FloatArray | None:
    """Return the rotation between two times by the samples of a buffer."""
    samples = gyro.between(first_ns, second_ns)
    found = integrals(samples, np.array([first_ns, second_ns]), bias_radps)
    return None if found is None else found.R_start_imu[-1]


def test_a_constant_rate_gives_the_exact_rotation_between_any_stamps() -> None:
    w = np.array([0.5, -1.0, 2.0])
    gyro = spinning(np.tile(w, (201, 1)))
    R = turned(gyro, 123_456_789, 876_543_210, np.zeros(3))
    expected = se3.exp(np.append(w * 0.753086421, np.zeros(3)))[:3, :3]
    assert R is not None
    np.testing.assert_allclose(R, expected, atol=1e-9)


def test_the_bias_is_taken_from_the_rates() -> None:
    gyro = spinning(np.tile([0.1, 0.2, 0.3], (201, 1)))
    R = turned(gyro, 0, NS_PER_S // 2, np.array([0.1, 0.2, 0.3]))
    assert R is not None
    np.testing.assert_allclose(R, np.eye(3), atol=1e-12)


def test_no_rotation_is_given_across_a_gap_or_beyond_the_samples() -> None:
    gyro = spinning(np.ones((21, 3)))  # up to 0.1 s
    gyro.add(Samples(np.array([200_000_000, 205_000_000]), np.ones((2, 3))))
    no_bias = np.zeros(3)
    assert turned(gyro, 50_000_000, 90_000_000, no_bias) is not None
    assert turned(gyro, 50_000_000, 203_000_000, no_bias) is None
    assert turned(gyro, 200_000_000, 225_000_000, no_bias) is not None  # held
    assert turned(gyro, 200_000_000, 235_000_000, no_bias) is None
    assert turned(gyro, -25_000_000, 50_000_000, no_bias) is not None  # held
    assert turned(gyro, -30_000_000, 50_000_000, no_bias) is None


def test_late_and_infinite_samples_are_dropped_and_counted() -> None:
    gyro = SampleBuffer()
    gyro.add(
        Samples(
            np.array([10, 30, 20, 40]), np.array([[1.0] * 3, [2.0] * 3, [3.0] * 3, [np.inf] * 3])
        )
    )
    assert len(gyro) == 2
    assert gyro.num_impossible == 1
    assert gyro.newest_ns == 30


@pytest.mark.parametrize('value', [1e300, 101.0, -np.inf, np.nan])
def test_samples_that_no_sensor_measures_are_left_out_counted_and_reported(value: float) -> None:
    shaken, bad = ShakenImu(accelerometer=True), np.array([[0.0, value, 0.0]])
    shaken.run(4.0)
    shaken.imu.trust.take_news()
    stamps_ns = START_NS + 4 * NS_PER_S + np.array([NS_PER_S // 5])
    shaken.imu.add_rates(Samples(stamps_ns, bad))
    shaken.imu.add_accelerations(Samples(stamps_ns, 10 * bad))
    shaken.run(6.0)
    (news,) = shaken.imu.trust.take_news()
    assert news.text.startswith('imu: samples beyond 100 rad/s or 1000 m/s^2')
    assert news.is_problem
    rotation = shaken.imu.rotation(START_NS + 4 * NS_PER_S, START_NS + 5 * NS_PER_S)
    assert rotation is not None
    true = se3.inverse(pose(4.0)) @ pose(5.0)
    assert angle_deg(rotation.R_first_second.T @ true[:3, :3]) < 0.5
    assert report_of(shaken.imu).samples_left_out == 2
    assert shaken.imu.trust.fault is None


def test_the_buffer_keeps_the_last_seconds_only_and_starts_again_with_the_stamps() -> None:
    gyro = SampleBuffer()
    for k in range(120):
        stamps_ns = k * NS_PER_S + np.arange(200) * 5_000_000
        gyro.add(Samples(stamps_ns, np.full((200, 3), float(k))))
    assert len(gyro) <= 2 * 200 * 41
    assert gyro.between(119 * NS_PER_S, 119 * NS_PER_S).values[0, 0] == 119.0
    gyro.add(Samples(np.array([5]), np.ones((1, 3))))
    assert gyro.newest_ns == 5
    assert len(gyro) == 1


@pytest.mark.parametrize('offset_ms', [-70, 0, 20, 70])
@pytest.mark.parametrize('R_camera_imu', [np.eye(3), AXES, ODD], ids=['optical', 'axes', 'odd'])
def test_offset_rotation_and_bias_are_found(offset_ms: int, R_camera_imu: FloatArray) -> None:
    shaken = ShakenImu(R_camera_imu, 1e-3 * offset_ms, BIAS)
    shaken.run(10.0)
    fit = shaken.imu.fit
    assert fit is not None
    assert 1e3 * fit.offset_s == pytest.approx(offset_ms, abs=2)
    assert angle_deg(fit.R_camera_imu.T @ R_camera_imu) < 0.5
    np.testing.assert_allclose(fit.bias_radps, BIAS, atol=2e-3)
    assert shaken.imu.trust.fault is None
    (news,) = shaken.imu.trust.take_news()
    assert news.text.startswith('imu: its stamps are ')
    assert not news.is_problem
    assert shaken.imu.trust.take_news() == []


def test_the_report_says_what_was_found() -> None:
    shaken = ShakenImu(ODD, 0.02, BIAS, accelerometer=True)
    assert report_of(shaken.imu) == ImuReport()
    shaken.run(8.0)
    report = report_of(shaken.imu)
    assert report.time_offset_ms == pytest.approx(20.0, abs=2.0)
    assert report.rotation_deg is not None
    expected_deg = np.rad2deg(se3.log(np.block([[ODD, np.zeros((3, 1))], [np.eye(4)[3:]]]))[:3])
    np.testing.assert_allclose(report.rotation_deg, expected_deg, atol=0.5)
    assert report.gyro_bias_radps == pytest.approx(BIAS, abs=2e-3)
    assert report.up_sigma_deg is not None
    assert report.up_sigma_deg < 1.5
    assert report.fault == ''
    assert report.in_use == 'gyro, accelerometer'


def test_the_bias_is_found_in_five_seconds() -> None:
    shaken = ShakenImu(AXES, 0.02, BIAS)
    shaken.run(5.0)
    assert shaken.imu.fit is not None
    np.testing.assert_allclose(shaken.imu.fit.bias_radps, BIAS, atol=2e-3)


def test_a_rotation_that_is_given_as_identity_is_corrected_and_reported() -> None:
    shaken = ShakenImu(AXES, given=Mounting(np.eye(3)))
    shaken.run(5.0)
    assert shaken.imu.fit is not None
    assert angle_deg(shaken.imu.fit.R_camera_imu.T @ AXES) < 1.0
    assert any('turned by 120 degrees' in news.text for news in shaken.imu.trust.take_news())


def test_a_right_mounting_is_kept_as_given() -> None:
    shaken = ShakenImu(ODD, given=Mounting(ODD))
    shaken.run(5.0)
    assert shaken.imu.fit is not None
    np.testing.assert_array_equal(shaken.imu.fit.R_camera_imu, ODD)


@pytest.mark.slow
def test_a_second_without_images_is_bridged_within_its_standard_deviation() -> None:
    errors_deg, sigmas_deg = [], []
    for seed in range(5):
        shaken = ShakenImu(AXES, 0.02, BIAS, seed=seed)
        shaken.run(6.0)
        shaken.sample(8 * NS_PER_S)
        first_ns = START_NS + round(shaken.time_s * 30) * IMAGE_NS
        rotation = shaken.imu.rotation(first_ns, first_ns + NS_PER_S)
        assert rotation is not None
        true = pose(shaken.time_s)[:3, :3].T @ pose(shaken.time_s + 1.0)[:3, :3]
        errors_deg.append(angle_deg(rotation.R_first_second.T @ true))
        sigmas_deg.append(np.rad2deg(rotation.sigma_rad))
    assert np.median(errors_deg) < 0.5
    assert max(errors_deg) < 3 * np.median(sigmas_deg)
    assert max(sigmas_deg) < 1.5


def _stuck(rates: FloatArray) -> FloatArray:
    return np.tile([0.01, 0.02, -0.01], (len(rates), 1))


@pytest.mark.parametrize(
    ('distort', 'fault'),
    [
        (_stuck, GyroFault.STUCK),
        (np.rad2deg, GyroFault.UNIT),
        (lambda rates: rates * np.array([1.0, -1.0, 1.0]), GyroFault.MIRRORED),
        (lambda rates: np.random.default_rng(0).normal(0, 1, rates.shape), GyroFault.DISAGREES),
    ],
    ids=['stuck', 'degrees', 'mirrored', 'noise'],
)  # fmt: skip
def test_a_fault_is_noticed_said_once_and_left_out(
    distort: Callable[[FloatArray], FloatArray], fault: GyroFault
) -> None:
    shaken = ShakenImu(distort=distort)
    shaken.run(4.0)
    assert shaken.imu.trust.fault is fault
    assert shaken.imu.trust.in_use == 'none'
    first_ns = START_NS + round(shaken.time_s * 30) * IMAGE_NS - NS_PER_S
    assert shaken.imu.rotation(first_ns, first_ns + IMAGE_NS) is None
    assert shaken.imu.trust.take_news() == [(f'imu: the gyro is left out: {fault.value}', True)]
    shaken.run(8.0)
    assert shaken.imu.trust.take_news() == []
    assert shaken.imu.trust.fault is fault


def test_rates_that_turn_into_degrees_are_noticed_within_three_seconds() -> None:
    shaken = ShakenImu(AXES, 0.02, BIAS)
    shaken.run(6.0)
    assert shaken.imu.trust.fault is None
    shaken.imu.trust.take_news()
    shaken.distort = np.rad2deg
    shaken.run(9.0)
    assert shaken.imu.trust.fault is GyroFault.UNIT
    texts = [news.text for news in shaken.imu.trust.take_news()]
    assert texts == [f'imu: the gyro is left out: {GyroFault.UNIT.value}']
    shaken.distort = None
    shaken.run(15.0)
    assert shaken.imu.trust.fault is None


def test_a_gyro_that_stops_is_late_and_one_that_returns_is_used_again() -> None:
    shaken = ShakenImu()
    shaken.run(3.0)
    assert shaken.imu.trust.fault is None
    shaken.is_silent = True
    shaken.run(6.0)
    assert shaken.imu.trust.fault is GyroFault.LATE
    shaken.is_silent = False
    shaken.run(12.0)
    assert shaken.imu.trust.fault is None


def test_a_saturated_turn_is_left_out() -> None:
    shaken = ShakenImu(distort=lambda rates: np.clip(rates, -1.05, 1.05))
    shaken.run(8.0)
    steps = [START_NS + k * IMAGE_NS for k in range(30, 240)]
    unknown = [ns for ns in steps if shaken.imu.rotation(ns, ns + IMAGE_NS) is None]
    assert 0 < len(unknown) < len(steps) / 2
    assert any('faster than the range' in news.text for news in shaken.imu.trust.take_news())


@pytest.mark.parametrize('gyro', [False, True], ids=['accelerometer', 'both'])
@pytest.mark.parametrize(
    'R_camera_imu', [np.diag([-1.0, -1.0, 1.0]), AXES], ids=['kinect', 'axes']
)
def test_up_is_found_from_a_tilted_start(R_camera_imu: FloatArray, gyro: bool) -> None:
    shaken = ShakenImu(R_camera_imu, 0.0, accelerometer=True, gyro=gyro)
    shaken.run(5.0)
    up = shaken.imu.up
    assert up is not None
    time_s = 1e-9 * (up.stamp_ns - START_NS)
    true = pose(time_s)[:3, :3].T @ UP_WORLD
    error_rad = float(np.arccos(np.clip(up.up_camera @ true, -1, 1)))
    assert np.rad2deg(error_rad) < 1.2
    assert error_rad < 3 * up.sigma_rad
    assert np.rad2deg(up.sigma_rad) < 1.5


@pytest.mark.parametrize('gyro', [False, True], ids=['accelerometer', 'both'])
def test_up_is_found_in_two_seconds(gyro: bool) -> None:
    shaken = ShakenImu(accelerometer=True, gyro=gyro)
    shaken.run(2.1)
    up = shaken.imu.up
    assert up is not None
    true = pose(1e-9 * (up.stamp_ns - START_NS))[:3, :3].T @ UP_WORLD
    assert np.rad2deg(np.arccos(up.up_camera @ true)) < 1.5


def test_a_calibrated_mounting_makes_up_more_certain() -> None:
    ups = []
    for sigma_deg in (1.0, 0.3):
        given = Mounting(ODD, sigma_rad=np.deg2rad(sigma_deg))
        shaken = ShakenImu(ODD, given=given, accelerometer=True, gyro=False)
        shaken.run(3.1)
        assert shaken.imu.up is not None
        ups.append(shaken.imu.up)
    stated, calibrated = ups
    true = pose(1e-9 * (calibrated.stamp_ns - START_NS))[:3, :3].T @ UP_WORLD
    assert np.rad2deg(np.arccos(calibrated.up_camera @ true)) < 0.6
    assert calibrated.sigma_rad < 0.8 * stated.sigma_rad


def test_an_accelerometer_that_gets_stuck_is_left_out() -> None:
    shaken = ShakenImu(AXES, accelerometer=True)
    shaken.run(5.0)
    assert shaken.imu.up is not None
    shaken.imu.trust.take_news()
    shaken.distort_force = lambda forces: np.tile([0.0, 9.81, 0.0], (len(forces), 1))
    shaken.run(8.0)
    assert shaken.imu.up is None
    texts = [news.text for news in shaken.imu.trust.take_news()]
    assert texts == [
        'imu: the accelerometer is left out: its values do not change; restart its driver'
    ]


@pytest.mark.parametrize('factor', [1 / 9.81, np.array([1.0, -1.0, 1.0])], ids=['g', 'mirrored'])
def test_a_faulty_accelerometer_gives_no_certain_up(factor: float | FloatArray) -> None:
    shaken = ShakenImu(accelerometer=True, distort_force=lambda forces: forces * factor)
    shaken.run(5.0)
    up = shaken.imu.up
    assert up is None or np.rad2deg(up.sigma_rad) > 3.0


def test_a_fault_stays_while_too_few_images_are_tracked() -> None:
    shaken = ShakenImu(distort=lambda rates: rates * np.array([1.0, -1.0, 1.0]))
    shaken.run(4.0)
    assert shaken.imu.trust.fault is GyroFault.MIRRORED
    later_ns = 34 * NS_PER_S  # more than the window of the comparison
    shaken.sample(later_ns + NS_PER_S // 10)
    last_ns = START_NS + later_ns
    shaken.imu.observe(last_ns - IMAGE_NS, last_ns, np.eye(4))
    assert shaken.imu.trust.fault is GyroFault.MIRRORED


@pytest.mark.parametrize(('offset_s', 'fault'), [(0.0, None), (0.3, GyroFault.LATE)])
def test_the_offset_of_a_mounting_that_becomes_known_is_used(
    offset_s: float, fault: GyroFault | None
) -> None:
    """Samples that end at the latest image are 0.3 s late if the stamps of the IMU are later."""
    imu = Imu(ImuConfig())
    imu.mount(Mounting(np.eye(3), offset_s))
    rng = np.random.default_rng(0)
    times_ns = np.arange(-NS_PER_S, NS_PER_S, NS_PER_S // 200)
    imu.add_rates(Samples(START_NS + times_ns, rng.normal(0, 0.1, (len(times_ns), 3))))
    for last_ns in (START_NS, START_NS + NS_PER_S):
        imu.observe(last_ns - IMAGE_NS, last_ns, np.eye(4))
    assert imu.trust.fault is fault
