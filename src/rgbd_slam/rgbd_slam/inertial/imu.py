"""An IMU beside the camera, calibrated and checked by the tracked motion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.dead_reckoning import TRIED_NS, WINDOW_NS, Path, Reckoned
from rgbd_slam.inertial.gravity import Gravity, GravityEstimator
from rgbd_slam.inertial.gyro_calibration import UNKNOWN_BIAS_RADPS, GyroFit, fit_gyro
from rgbd_slam.inertial.integrals import integrals
from rgbd_slam.inertial.mounting import PARALLEL_SIGMA_RAD, Mounting, snapped
from rgbd_slam.inertial.rotations import rotation_vector
from rgbd_slam.inertial.sample_buffer import (
    MAX_FORCE_MPS2,
    MAX_RATE_RADPS,
    SampleBuffer,
    Samples,
)
from rgbd_slam.inertial.tracked_motion import TrackedMotion
from rgbd_slam.inertial.trust import Trust, is_saturated, is_stuck

# Chosen: time between two comparisons with the tracked motion, at first and once the time offset
# is known, because a comparison takes 5 to 15 ms.
_FIRST_PERIOD_NS, _PERIOD_NS = NS_PER_S // 2, 2 * NS_PER_S
# Chosen: with an accelerometer, the short period lasts at least this long, because gravity is
# known after 1.5 s and can be confirmed after 2.3 s.
_EARLY_NS = 3 * NS_PER_S
# Chosen: an offset with this standard deviation is known; a hand turns by 0.5 degrees in 5 ms.
_KNOWN_OFFSET_S = 0.005
# Chosen: an estimated rotation between IMU and camera is not used for prediction if its standard
# deviation is larger; different parallel-axes rotations differ by 90 degrees.
_MAX_ROTATION_SIGMA_RAD = np.deg2rad(25.0)
# Chosen: a given rotation is contradicted by more than this angle plus three sigmas.
_CONTRADICTED_RAD, _NUM_SIGMAS = np.deg2rad(3.0), 3.0
# Chosen: factor on standard deviations, because tracking errors are correlated over seconds.
_CORRELATED = 2.0
# Chosen: standard deviation of a rotation measured over 1 s, ten times that from a gyro's white
# noise, because real gyros also have scale errors.
_NOISE_RAD = 0.002
_SCALE_ERROR = 0.01  # chosen: scale error of cheap gyros (Bosch BMI055: 1 %)
# Chosen: least accuracy of gravity for dead reckoning; the limit of `Leveling`.
_MAX_UP_SIGMA_RAD = np.deg2rad(3.0)
_DRIFT_RAD = np.deg2rad(1.0)  # chosen: error of a direction that was tracked over 2 s
_MAX_STEP_NS = NS_PER_S // 5  # chosen: tracked rotations over longer steps are not used
_CONTRADICTED = (
    'imu: it is turned by {:.0f} degrees from what its frame or its calibration says; the '
    'rotation that the images show is used'
)
_IMPOSSIBLE = 'imu: samples beyond 100 rad/s or 1000 m/s^2, or not finite, are left out'
_SATURATED = 'imu: it turns faster than the range of the gyro; such turns are left out'


class MeasuredRotation(NamedTuple):
    """The rotation of the camera between two images, as measured by the gyro."""

    R_first_second: FloatArray  # (3, 3)
    sigma_rad: float  # standard deviation about each axis


class Imu:
    """Measures how the camera turns and moves, and which direction is up.

    Time offset, rotation to the camera and biases are estimated from the tracked motion
    (`observe`). `trust` decides which sensors are used.
    """

    def __init__(self, config: ImuConfig, mounting: Mounting | None = None) -> None:
        self._config, self._mounting = config, mounting
        self._gyro = SampleBuffer(MAX_RATE_RADPS)
        self._accelerometer = SampleBuffer(MAX_FORCE_MPS2)
        self._motion, self.trust = TrackedMotion(), Trust()
        self._gravity = GravityEstimator(self._motion)
        self._offset_s = 0.0 if mounting is None else mounting.offset_s
        # Stamp of the image at which samples and motion were compared last.
        self._compared_ns: int | None = None
        self._begun_ns = 0  # stamp of the image at which the short period of comparisons began
        # Stamp of the last image of the latest trials of dead reckoning, and their error.
        self._trial: tuple[int | None, float | None] = None, None
        self.levels = config.level  # whether gravity is measured in order to level the map
        self.fit: GyroFit | None = None  # result of the last comparison without a fault
        self.up: Gravity | None = None  # result of the last comparison

    def add_rates(self, rates_radps: Samples) -> None:
        if not len(self._gyro) and len(rates_radps):  # imports GTSAM before an image needs it
            integrals(rates_radps, rates_radps.stamps_ns[[0, -1]], np.zeros(3))
        self._gyro.add(rates_radps)

    def add_accelerations(self, accelerations_mps2: Samples) -> None:
        """Add samples of the accelerometer; at rest they point upwards (REP 145)."""
        self._accelerometer.add(accelerations_mps2)

    def observe(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Update the calibration by the motion T_first_second (4, 4) tracked between two images.

        Every 0.5 s, or every 2 s once the time offset is known, the motion is compared with the
        samples, which updates `fit`, `trust` and `up`.
        """
        if self.num_impossible:
            self.trust.say(_IMPOSSIBLE)
        has_gyro = bool(self._config.gyro and len(self._gyro))
        needs_up = self.levels or (has_gyro and self._config.integrate)
        has_accelerometer = bool(needs_up and len(self._accelerometer))
        if not has_gyro and not has_accelerometer:
            return
        self._motion.add(first_ns, second_ns, T_first_second)
        if not self._is_due(second_ns, has_accelerometer=has_accelerometer):
            return
        self._compared_ns = second_ns
        if has_gyro:
            self._compare_rates(second_ns)
        if has_accelerometer:
            self._compare_forces(second_ns)
        self.trust.report()

    def rotation(self, first_ns: int, second_ns: int) -> MeasuredRotation | None:
        """Return the camera rotation between two images; None if samples or trust are missing."""
        fit = self.fit
        if fit is None or not self.trust.uses_gyro or second_ns <= first_ns:
            return None
        ends_ns = np.array([first_ns, second_ns]) + round(fit.offset_s * NS_PER_S)
        samples = self._gyro.between(*ends_ns.tolist())
        found = integrals(samples, ends_ns, fit.bias_radps)
        if found is None or is_stuck(self._gyro, int(ends_ns[1])):
            return None
        if is_saturated(samples):
            self.trust.say(_SATURATED)
            return None
        R = fit.R_camera_imu @ found.R_start_imu[-1] @ fit.R_camera_imu.T
        elapsed_s = S_PER_NS * (second_ns - first_ns)
        turn_rad = float(np.linalg.norm(rotation_vector(R)))
        of_turn = math.hypot(fit.rotation_sigma_rad, _SCALE_ERROR) * turn_rad
        of_offset = fit.offset_sigma_s * turn_rad / max(elapsed_s, 2 * fit.offset_sigma_s)
        of_bias = fit.bias_sigma_radps * elapsed_s
        noise = _NOISE_RAD * math.sqrt(elapsed_s)
        return MeasuredRotation(R, math.hypot(of_turn, of_offset, of_bias, noise))

    def position(self, last_ns: int, stamp_ns: int) -> Reckoned | None:
        """Return the position at a time in the camera frame of the last tracked image.

        None unless the accelerometer is trusted, gravity is known to 3 degrees, enough images were
        tracked without interruption, and dead reckoning agrees with them.
        """
        if not (self._config.integrate and self.trust.uses_gyro):
            return None
        error = self._trial_error(last_ns)
        if error is None or not self.trust.agrees:
            return None
        path = self._path(last_ns, WINDOW_NS, stamp_ns)
        if path is None:
            return None
        last = len(path.positions_m) - 1
        return path.reckoned(last, slice(last + 1, last + 2), max(error, 1.0) ** 2)

    @property
    def confirmed_up(self) -> Gravity | None:
        """Return `up` if it is accurate and confirmed enough to level the map, else None."""
        up = self.up
        return up if up is not None and self.trust.may_level(up.sigma_rad) else None

    @property
    def num_impossible(self) -> int:
        """Return the number of samples that were left out because their values are impossible."""
        return self._gyro.num_impossible + self._accelerometer.num_impossible

    @property
    def gives_prior(self) -> bool:
        """Return whether measured rotations may be used as priors of tracked poses."""
        return self._config.prior

    @property
    def bias_sigma_radps(self) -> float:
        """Return the standard deviation of the gyro's bias; 0.02 rad/s before the first fit."""
        return UNKNOWN_BIAS_RADPS if self.fit is None else self.fit.bias_sigma_radps

    def mount(self, mounting: Mounting) -> None:
        """Use a mounting that has become known now, unless one was given before."""
        if self._mounting is None:
            self._mounting = mounting
            if self.fit is None:
                self._offset_s = mounting.offset_s

    def _is_due(self, stamp_ns: int, *, has_accelerometer: bool) -> bool:
        """Return whether the next comparison with the tracked motion is due."""
        before_ns = self._compared_ns
        if before_ns is None or stamp_ns < before_ns:
            self._begun_ns = self._compared_ns = stamp_ns
            return False
        is_early = has_accelerometer and before_ns - self._begun_ns < _EARLY_NS
        period_ns = _PERIOD_NS if self._is_offset_known and not is_early else _FIRST_PERIOD_NS
        return stamp_ns - before_ns >= period_ns

    @property
    def _is_offset_known(self) -> bool:
        return self.fit is not None and self.fit.offset_sigma_s < _KNOWN_OFFSET_S

    def _compare_rates(self, image_ns: int) -> None:
        """Update the calibration of the gyro, unless the gyro has a fault."""
        offset_ns = round(self._offset_s * NS_PER_S)
        if not self.trust.compare_samples(self._gyro, image_ns, offset_ns):
            return
        near_s = self._offset_s if self._is_offset_known else None
        free = fit_gyro(self._motion, self._gyro, None, near_s)
        if free is None or not self.trust.compare_rates(free, self._recent_fit()):
            return
        sigma_rad = _CORRELATED * free.rotation_sigma_rad
        R = self._chosen_rotation(free.R_camera_imu, sigma_rad)
        fit, is_certain = free, sigma_rad < _MAX_ROTATION_SIGMA_RAD
        if R is not free.R_camera_imu:
            fit = fit_gyro(self._motion, self._gyro, R, free.offset_s) or free
            sigma_rad = min(sigma_rad, PARALLEL_SIGMA_RAD)
        is_given = self._mounting is not None and R is self._mounting.R_camera_imu
        self.trust.compare_axes(
            fit,
            is_expected=is_given or np.array_equal(R, np.eye(3)),
            is_certain=bool(is_certain or is_given),
        )
        self.fit = fit._replace(
            rotation_sigma_rad=sigma_rad, offset_sigma_s=_CORRELATED * fit.offset_sigma_s
        )
        self._offset_s = fit.offset_s
        if self.trust.uses_gyro and fit.offset_sigma_s < _KNOWN_OFFSET_S:
            self.trust.say(self.fit.text, 'found', is_problem=False)

    def _recent_fit(self) -> GyroFit | None:
        if self.fit is None or not self.trust.uses_gyro:
            return None
        R, offset_s = self.fit.R_camera_imu, self._offset_s
        return fit_gyro(self._motion, self._gyro, R, offset_s, _PERIOD_NS)

    def _chosen_rotation(self, R_found: FloatArray, sigma_rad: float) -> FloatArray:
        """Return the given R_camera_imu (3, 3), or `R_found` (3, 3) if that contradicts it."""
        if self._mounting is None:
            return snapped(R_found, sigma_rad)
        given = self._mounting.R_camera_imu
        angle_rad = float(np.linalg.norm(rotation_vector(given.T @ R_found)))
        if angle_rad < _CONTRADICTED_RAD + _NUM_SIGMAS * sigma_rad:
            return given
        self.trust.say(_CONTRADICTED.format(np.rad2deg(angle_rad)), 'mounting')
        return snapped(R_found, sigma_rad)

    def _compare_forces(self, image_ns: int) -> None:
        """Update `up` (None if gravity is unknown), and try dead reckoning."""
        self.up = None
        if not self.trust.compare_forces(self._accelerometer, image_ns):
            return
        self._gravity.measure(self._accelerometer, round(self._offset_s * NS_PER_S))
        mounting, fit = self._mounting, self.fit
        if fit is not None and self.trust.uses_gyro:
            is_given = mounting is not None and mounting.R_camera_imu is fit.R_camera_imu
            mounting = mounting if is_given else Mounting(fit.R_camera_imu)
        self.up = self._gravity.fit(mounting)
        self._trial_error(image_ns)

    def _trial_error(self, last_ns: int) -> float | None:
        """Return the error of dead reckoning over the last seconds, and update `trust` by it."""
        if self._trial[0] != last_ns:
            path = self._path(last_ns, TRIED_NS)
            self._trial = last_ns, None if path is None else path.trial_error()
            self.trust.compare_positions(self._trial[1])
        return self._trial[1]

    def _path(self, last_ns: int, window_ns: int, stamp_ns: int | None = None) -> Path | None:
        """Return the positions tracked in a window up to an image, and the IMU's integrals.

        The integrals continue from that image to `stamp_ns`, if that is given.
        """
        up = self.up
        stamps_ns, T = self._motion.chain(last_ns - window_ns)
        if up is None or up.sigma_rad > _MAX_UP_SIGMA_RAD:
            return None
        of_up = self._motion.chain(up.stamp_ns).T_chain_camera[:1, :3, :3]
        if not len(stamps_ns) or stamps_ns[-1] != last_ns or not len(of_up):
            return None
        at_ns = stamps_ns if stamp_ns is None else np.append(stamps_ns, stamp_ns)
        imu_ns, R = at_ns + round(self._offset_s * NS_PER_S), up.R_camera_imu
        ends_ns = int(imu_ns[0]), int(imu_ns[-1])
        rates, bias_radps = self._tracked_rates(int(at_ns[0]), R), np.zeros(3)
        if self.fit is not None and self.trust.uses_gyro:
            rates, bias_radps = self._gyro.between(*ends_ns), self.fit.bias_radps
        forces = self._accelerometer.between(*ends_ns)
        found = integrals(rates, imu_ns, bias_radps, forces, R.T @ up.bias_mps2)
        if found is None:
            return None
        R_chain_last = T[-1, :3, :3]
        R_last_start = R @ found.R_start_imu[len(stamps_ns) - 1].T
        return Path(
            np.asarray(S_PER_NS * (at_ns - last_ns), np.float64),
            (T[:, :3, 3] - T[-1, :3, 3]) @ R_chain_last,
            found.R_start_imu,
            found.velocity_mps @ R_last_start.T,
            found.moved_m @ R_last_start.T,
            R_chain_last.T @ of_up[0] @ up.up_camera,
            math.hypot(up.sigma_rad, _DRIFT_RAD),
        )

    def _tracked_rates(self, from_ns: int, R_camera_imu: FloatArray) -> Samples:
        """Return the rates that a gyro would measure according to the tracked rotations."""
        first_ns, second_ns, R = self._motion.steps(from_ns, _MAX_STEP_NS)
        rates_radps = rotation_vector(R) / (S_PER_NS * (second_ns - first_ns))[:, None]
        middle_ns = (first_ns + second_ns) // 2 + round(self._offset_s * NS_PER_S)
        return Samples(middle_ns, rates_radps @ R_camera_imu)
