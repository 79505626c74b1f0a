"""An IMU beside the camera: calibrated by the tracked motion, it gives rotations and up."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.faults import (
    GyroFault,
    fault_of_fit,
    fault_of_recent_rates,
    fault_of_samples,
    is_saturated,
    is_stuck,
)
from rgbd_slam.inertial.force_integral import ForceIntegral, force_integral
from rgbd_slam.inertial.gravity import GravityEstimator, GravityFit
from rgbd_slam.inertial.gyro_calibration import UNKNOWN_BIAS_RADPS, GyroCalibration, GyroFit
from rgbd_slam.inertial.gyro_integral import rotation_between, rotation_vector
from rgbd_slam.inertial.mounting import PARALLEL_SIGMA_RAD, Mounting, snapped
from rgbd_slam.inertial.sample_buffer import MAX_FORCE_MPS2, MAX_RATE_RADPS, SampleBuffer, Samples

# Chosen: time between two comparisons with the tracked motion, at first and once the time offset
# is known; a comparison takes 5 to 15 ms.
_FIRST_PERIOD_NS, _PERIOD_NS = NS_PER_S // 2, 2 * NS_PER_S
# Chosen: with an accelerometer, the first period also lasts for this time after the first image,
# because gravity is known after 1.5 s, and can be confirmed after 2.3 s.
_EARLY_NS = 3 * NS_PER_S
_KNOWN_OFFSET_S = 0.005  # chosen: standard deviation; a hand turns by 0.5 degrees in 5 ms
# Chosen: an estimated rotation between IMU and camera with a larger standard deviation is not used
# to predict; the rotations between parallel axes differ by 90 degrees.
_MAX_ROTATION_SIGMA_RAD = np.deg2rad(25.0)
_CONTRADICTED_RAD, _NUM_SIGMAS = np.deg2rad(3.0), 3.0  # chosen: see `snapped`
# Chosen: the mounting of the gyro counts as known once its rates correlate with the tracked ones
# by more than this. The first number holds if the axes of the IMU are the given ones or parallel
# to the optical ones, the second if they were found from the images alone. Where a moving scene
# captures the tracking of `d435_office`, a mirrored gyro reaches 0.73 with some rotation.
_EXPECTED_CORRELATION, _FOUND_CORRELATION = 0.6, 0.85
_CORRELATED = 2.0  # chosen: factor of standard deviations, as errors of tracking last for seconds
# Chosen: ten times the standard deviation of the integral of a gyro's white noise after 1 s,
# because real gyros also have errors of their scale.
_NOISE_RAD = 0.002
_SCALE_ERROR = 0.01  # chosen: of cheap gyros (Bosch BMI055: 1 %)
_MAX_UP_SIGMA_RAD = np.deg2rad(3.0)  # chosen: the limit of `Leveling`
# Chosen: before the accelerometer has been compared with the tracked motion, the map is made level
# only if the standard deviation of the direction of gravity is below this. On calm cameras it is
# 1.1 to 1.2 degrees after 1.5 s, and 2.0 to 4.4 if the axes of the accelerometer are permuted.
_UNTRIED_SIGMA_RAD = np.deg2rad(1.5)
_FAULTS_OF_SAMPLES = GyroFault.STUCK, GyroFault.LATE  # the samples show their end as well
_LEFT_OUT = 'imu: the gyro is left out: {}'
_IMPOSSIBLE = 'imu: samples beyond 100 rad/s or 1000 m/s^2, or not finite, are left out'
_SATURATED = 'imu: it turns faster than the range of the gyro; such turns are left out'
# Chosen: time without agreement after which it is reported that the map does not become level.
_UNLEVEL_NS = 10 * NS_PER_S
_CONTRADICTS = (
    'imu: the map is not made level, because the accelerometer does not agree with the tracked '
    'motion; check its axes and stamps, or turn the camera more slowly'
)
_STUCK_ACCELEROMETER = (
    'imu: the accelerometer is left out: its values do not change; restart its driver'
)


class MeasuredRotation(NamedTuple):
    """The rotation of the camera between two images, as the gyro has measured it."""

    R_first_second: FloatArray  # (3, 3)
    sigma_rad: float  # standard deviation about each axis


class News(NamedTuple):
    """A message about the IMU, which is reported once."""

    text: str
    is_problem: bool


class Up(NamedTuple):
    """The direction opposite to gravity at an image."""

    stamp_ns: int
    up_camera: FloatArray  # (3,) unit vector
    sigma_rad: float


class Imu:
    """Measures how the camera turns, and which direction is up.

    The time offset, the rotation to the camera and the biases are estimated from the tracked
    motion (`observe`). A gyro that contradicts it is left out until a comparison shows no fault.

    Args:
        config: Parameters.
        mounting: How the IMU is mounted, if somebody has measured it.
    """

    def __init__(self, config: ImuConfig, mounting: Mounting | None = None) -> None:
        self._config, self._mounting = config, mounting
        self._gyro, self._accelerometer = (
            SampleBuffer(MAX_RATE_RADPS),
            SampleBuffer(MAX_FORCE_MPS2),
        )
        self._calibration, self._gravity = GyroCalibration(), GravityEstimator()
        self._offset_s = 0.0 if mounting is None else mounting.offset_s
        self._compared_ns: int | None = None  # stamp of the image of the last comparison
        self._begun_ns = 0  # stamp of the image at which the first period began
        self._is_mounting_known = False
        self._gravity_fit: GravityFit | None = None  # by the last comparison
        # Whether the accelerometer agrees with the tracked motion; None = not tried.
        self._agrees: bool | None = None
        self._contradicted_ns: int | None = None  # stamp since which it does not; None = it does
        self._news: list[News] = []
        self._said: set[str] = set()
        self.levels = config.level  # whether gravity is measured to make the map level
        self.fit: GyroFit | None = None  # by the last comparison in which there was no fault
        self.fault: GyroFault | None = None  # why the gyro is left out
        self.up: Up | None = None  # by the last comparison
        self.num_refused = 0  # comparisons in which the gyro had a fault

    def add_rates(self, rates_radps: Samples) -> None:
        """Add samples of the gyro."""
        self._gyro.add(rates_radps)

    def add_accelerations(self, accelerations_mps2: Samples) -> None:
        """Add samples of the accelerometer; at rest they point upwards (REP 145)."""
        self._accelerometer.add(accelerations_mps2)

    def observe(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Learn from the tracked motion (4, 4) of the camera between two images.

        Every 0.5 s, or every 2 s once the time offset is known, the motion is compared with the
        samples, which updates `fit`, `fault` and `up`. With an accelerometer, it stays 0.5 s for
        the first 3 s. A sensor that is switched off or has sent no sample is left out.
        """
        if self.num_impossible:
            self._say(_IMPOSSIBLE)
        has_gyro = bool(self._config.gyro and len(self._gyro))
        needs_up = self.levels or (has_gyro and self._config.integrate)
        has_accelerometer = bool(needs_up and len(self._accelerometer))
        if has_gyro:
            self._calibration.add(first_ns, second_ns, T_first_second[:3, :3])
        if has_accelerometer:
            self._gravity.add(first_ns, second_ns, T_first_second)
        if not self._is_due(second_ns, has_accelerometer=has_accelerometer):
            return
        self._compared_ns = second_ns
        if has_gyro:
            self._compare(second_ns)
        if has_accelerometer:
            self._measure_up(second_ns)

    def rotation(self, first_ns: int, second_ns: int) -> MeasuredRotation | None:
        """Return how the camera has turned between the stamps of two images.

        None is returned if samples are missing or saturated, while the gyro has a `fault`, and
        until the tracked motion has shown how the gyro is mounted and that it is right. The first
        saturation is reported by `take_news`.
        """
        fit = self.fit
        if fit is None or not self._is_gyro_confirmed:
            return None
        offset_ns = round(fit.offset_s * NS_PER_S)
        ends_ns = first_ns + offset_ns, second_ns + offset_ns
        samples = self._gyro.between(*ends_ns)
        R_imu = rotation_between(samples, *ends_ns, fit.bias_radps)
        if R_imu is None:
            return None
        if is_saturated(samples):
            self._say(_SATURATED)
            return None
        R = fit.R_camera_imu @ R_imu @ fit.R_camera_imu.T
        elapsed_s = S_PER_NS * (second_ns - first_ns)
        turn_rad = math.acos(min(max((float(np.trace(R)) - 1.0) / 2, -1.0), 1.0))
        of_turn = math.hypot(fit.rotation_sigma_rad, _SCALE_ERROR) * turn_rad
        of_offset = fit.offset_sigma_s * turn_rad / max(elapsed_s, 2 * fit.offset_sigma_s)
        of_bias = fit.bias_sigma_radps * elapsed_s
        noise = _NOISE_RAD * math.sqrt(elapsed_s)
        return MeasuredRotation(R, math.hypot(of_turn, of_offset, of_bias, noise))

    def forces(self, first_ns: int, origin_ns: int, last_ns: int) -> ForceIntegral | None:
        """Return the integrals of the specific force between the stamps of two images.

        None is returned if samples are missing, and unless the gyro is confirmed and gravity is
        known to 3 degrees (`up`).

        Args:
            first_ns: Stamp of the first image.
            origin_ns: Stamp of the image in whose camera frame the forces are integrated.
            last_ns: Stamp of the last image.
        """
        fit, gravity, up = self.fit, self._gravity_fit, self.up
        if fit is None or gravity is None or up is None or up.sigma_rad > _MAX_UP_SIGMA_RAD:
            return None
        if not self._is_gyro_confirmed:
            return None
        offset_ns = round(fit.offset_s * NS_PER_S)
        return force_integral(
            self._accelerometer,
            self._gyro,
            (first_ns + offset_ns, origin_ns + offset_ns, last_ns + offset_ns),
            gravity.R_camera_imu,
            (fit.bias_radps, gravity.R_camera_imu.T @ gravity.bias_mps2),
        )

    def judge_accelerometer(self, *, agrees: bool | None) -> None:
        """Store whether the accelerometer agrees with the tracked motion.

        A map that does not become level for 10 s because of a contradiction is reported once.

        Args:
            agrees: Whether it does; None: it could not be tried.
        """
        self._agrees = agrees
        if agrees is not False or self._compared_ns is None:
            self._contradicted_ns = None
            return
        self._contradicted_ns = self._contradicted_ns or self._compared_ns
        if self._compared_ns - self._contradicted_ns >= _UNLEVEL_NS:
            self._say(_CONTRADICTS)

    @property
    def num_impossible(self) -> int:
        """Return the number of samples that were left out because no sensor measures that."""
        return self._gyro.num_impossible + self._accelerometer.num_impossible

    @property
    def confirmed_up(self) -> Up | None:
        """Return `up` if the map may be made level by it, else None.

        Beside a confirmed gyro, the accelerometer must agree with the tracked motion
        (`judge_accelerometer`). As long as that could not be tried, gravity must be known to 1.5
        degrees. Without a gyro it cannot be tried, and `up` is returned.
        """
        up = self.up
        if up is None or self._agrees or not self._is_gyro_confirmed:
            return up
        is_certain = up.sigma_rad < _UNTRIED_SIGMA_RAD
        return up if self._agrees is None and is_certain else None

    @property
    def integrates(self) -> bool:
        """Return whether the accelerometer may predict the position while images fail."""
        return self._config.integrate

    @property
    def gives_prior(self) -> bool:
        """Return whether measured rotations may support the poses of tracked images."""
        return self._config.prior

    @property
    def bias_sigma_radps(self) -> float:
        """Return the standard deviation of the bias of the gyro; before a fit, 0.02 rad/s."""
        return UNKNOWN_BIAS_RADPS if self.fit is None else self.fit.bias_sigma_radps

    def mount(self, mounting: Mounting) -> None:
        """Use a mounting that has become known; its `offset_s` only before there is a `fit`.

        A mounting that was given before is kept instead.
        """
        if self._mounting is None:
            self._mounting = mounting
            if self.fit is None:
                self._offset_s = mounting.offset_s

    def stop_measuring_up(self) -> None:
        """Measure gravity only to bridge losses from now on, because the map is level for good."""
        self.levels = False

    @property
    def problem(self) -> str:
        """Return why the gyro is left out, or ''."""
        return '' if self.fault is None else _LEFT_OUT.format(self.fault.value)

    def take_news(self) -> list[News]:
        """Return the messages about the IMU since the last call, and remove them."""
        news, self._news = self._news, []
        return news

    @property
    def _is_gyro_confirmed(self) -> bool:
        """Return whether the tracked motion has shown how the gyro is mounted, and no fault."""
        return self.fit is not None and self.fault is None and self._is_mounting_known

    def _is_due(self, stamp_ns: int, *, has_accelerometer: bool) -> bool:
        """Return whether the next comparison with the tracked motion is due.

        At the first image, and after stamps that go back, the period begins anew at `stamp_ns`.
        """
        before_ns, fit = self._compared_ns, self.fit
        if before_ns is None or stamp_ns < before_ns:
            self._begun_ns = self._compared_ns = stamp_ns
            return False
        is_known = fit is not None and fit.offset_sigma_s < _KNOWN_OFFSET_S
        is_early = has_accelerometer and before_ns - self._begun_ns < _EARLY_NS
        period_ns = _PERIOD_NS if is_known and not is_early else _FIRST_PERIOD_NS
        return stamp_ns - before_ns >= period_ns

    def _compare(self, image_ns: int) -> None:
        """Update `fit` and `fault` by a comparison with the tracked rotation.

        A fault is counted and stored for `take_news`. A fault that an earlier comparison has shown
        stays while too few rotations are tracked.
        """
        shown = None if self.fault in _FAULTS_OF_SAMPLES else self.fault
        offset_ns = round(self._offset_s * NS_PER_S)
        self.fault = fault_of_samples(self._gyro, image_ns, offset_ns)
        if self.fault is None:
            self._fit(shown)
        if self.fault is not None:
            self.num_refused += 1
            self._say(self.problem)

    def _fit(self, shown: GyroFault | None) -> None:
        """Update the calibration and its fault; the last calibration stays if there is a fault.

        Args:
            shown: The fault by earlier comparisons, which stays if this one shows nothing.
        """
        before = self.fit
        if before is not None and self._is_mounting_known:
            recent = self._calibration.recent_rates(self._gyro, before)
            self.fault = None if recent is None else fault_of_recent_rates(recent)
            if self.fault is not None:
                return
        is_known = before is not None and before.offset_sigma_s < _KNOWN_OFFSET_S
        free = self._calibration.fit(self._gyro, None, self._offset_s if is_known else None)
        if free is None:
            self.fault = shown
            return
        self.fault = fault_of_fit(free)
        if self.fault is not None:
            return
        sigma_rad = _CORRELATED * free.rotation_sigma_rad
        R = self._chosen_rotation(free.R_camera_imu, sigma_rad)
        fit, is_certain = free, sigma_rad < _MAX_ROTATION_SIGMA_RAD
        if R is not free.R_camera_imu:
            fit = self._calibration.fit(self._gyro, R, free.offset_s) or free
            sigma_rad = min(sigma_rad, PARALLEL_SIGMA_RAD)
        is_given = self._mounting is not None and R is self._mounting.R_camera_imu
        is_expected = is_given or np.array_equal(R, np.eye(3))
        needed = _EXPECTED_CORRELATION if is_expected else _FOUND_CORRELATION
        self._is_mounting_known |= (is_certain or is_given) and fit.correlation > needed
        self.fit = fit._replace(
            rotation_sigma_rad=sigma_rad, offset_sigma_s=_CORRELATED * fit.offset_sigma_s
        )
        self._offset_s = fit.offset_s
        if self._is_mounting_known and fit.offset_sigma_s < _KNOWN_OFFSET_S:
            self._say(self.fit.text, 'found', is_problem=False)

    def _chosen_rotation(self, R_found: FloatArray, sigma_rad: float) -> FloatArray:
        """Return the given R_camera_imu (3, 3), unless the images contradict it.

        If there is no given rotation, or it is contradicted, `snapped` of the rotation that was
        found is returned. A contradiction is stored for `take_news`.

        Args:
            R_found: (3, 3) rotation R_camera_imu by the images.
            sigma_rad: Standard deviation of `R_found`.
        """
        if self._mounting is None:
            return snapped(R_found, sigma_rad)
        given = self._mounting.R_camera_imu
        angle_rad = float(np.linalg.norm(rotation_vector(given.T @ R_found)))
        if angle_rad < _CONTRADICTED_RAD + _NUM_SIGMAS * sigma_rad:
            return given
        self._say(
            f'imu: it is turned by {np.rad2deg(angle_rad):.0f} degrees from what its frame or its '
            'calibration says; the rotation that the images show is used',
            'mounting',
        )
        return snapped(R_found, sigma_rad)

    def _measure_up(self, image_ns: int) -> None:
        """Update `up`, the direction opposite to gravity; it becomes None if it is unknown."""
        if is_stuck(self._accelerometer):
            self._gravity, self._gravity_fit, self.up = GravityEstimator(), None, None
            self._say(_STUCK_ACCELEROMETER)
            return
        self._gravity.measure(self._accelerometer, round(self._offset_s * NS_PER_S))
        mounting, fit = self._mounting, self.fit
        if fit is not None and self._is_gyro_confirmed:
            is_given = mounting is not None and mounting.R_camera_imu is fit.R_camera_imu
            mounting = mounting if is_given else Mounting(fit.R_camera_imu)
        self._gravity_fit = found = self._gravity.fit(mounting)
        self.up = None if found is None else Up(image_ns, found.up_camera, found.up_sigma_rad)

    def _say(self, text: str, kind: str = '', *, is_problem: bool = True) -> None:
        """Store a text for `take_news`, unless a text of the same kind was stored before.

        Without a `kind`, only an equal text is of the same kind.
        """
        if (kind or text) not in self._said:
            self._said.add(kind or text)
            self._news.append(News(text, is_problem))
