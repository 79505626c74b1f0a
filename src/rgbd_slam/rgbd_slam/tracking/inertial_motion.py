"""Motion from an IMU: rotations by the gyro; positions by the accelerometer or last velocity."""

from __future__ import annotations

import math

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.inertial.attitude_filter import AttitudeFilter
from rgbd_slam.inertial.dead_reckoning import Reckoned
from rgbd_slam.inertial.gravity import GRAVITY_MPS2
from rgbd_slam.inertial.imu import Imu, MeasuredRotation
from rgbd_slam.inertial.rotations import rotation_vector
from rgbd_slam.tracking.motion_sources import BridgedMotion

_DECAY_S = 0.4  # measured: time constant with which a hand-held camera loses its velocity
# Chosen: time over which tracked motions are averaged to a velocity: three images.
_SMOOTHING_S = 0.1
_SPREAD_S = 5.0  # chosen: time over which the variance of the velocity is averaged
_INITIAL_SPREAD_MPS = 0.2  # chosen: standard deviation along each axis for a hand-held camera
# Chosen: for less time, over three images, the last velocity predicts as well.
_LEAST_RECKONED_S = 0.1
_MAX_BRIDGE_S = 1.5  # chosen: after this time, the position error exceeds about 0.2 m
# Chosen: time over which a rate is measured, about one readout of an image.
_RATE_NS = NS_PER_S // 50
_SOURCE = 'the gyro'


class InertialMotion:
    """Predicts the camera motion by a gyro, and bridges up to 1.5 s without tracking.

    The gyro measures the rotation. After 0.1 s, an accelerometer measures the position, if it
    agrees with the tracked motion (`dead_reckoning`). Otherwise the position follows from the last
    velocity, which decays with a time constant of 0.4 s (an Ornstein-Uhlenbeck process) and whose
    variance is learned.
    """

    def __init__(self, imu: Imu) -> None:
        self._imu = imu
        self._start_ns = self._stamp_ns = self._step_ns = 0
        # In the camera frame of the last tracked image.
        self._velocity_mps: FloatArray = np.zeros(3)
        self._attitude = AttitudeFilter()
        # By the stamps of both images: rotation and position since the last tracked image.
        self._turn: tuple[tuple[int, int], MeasuredRotation | None] = (0, 0), None
        self._reckoned: tuple[tuple[int, int], Reckoned | None] = (0, 0), None
        self._observed_ns = 0  # stamp of the last tracked image
        self._variance_m2ps2 = _INITIAL_SPREAD_MPS**2  # variance of the velocity along each axis

    def start(self, stamp_ns: int) -> None:
        self._start_ns = self._stamp_ns = stamp_ns
        if stamp_ns != self._observed_ns:
            self._attitude.restart()

    def advance(self, stamp_ns: int) -> None:
        self._step_ns, self._stamp_ns = stamp_ns - self._stamp_ns, stamp_ns

    def observe(self, T_last_camera: FloatArray) -> None:
        """Update the velocity by the tracked motion, and let the IMU calibrate itself by it."""
        elapsed_s = self._elapsed_s
        if elapsed_s <= 0:
            return
        rotation = self._rotation()
        R_gyro = None if rotation is None else rotation.R_first_second
        self._attitude.add(R_gyro, T_last_camera[:3, :3], elapsed_s, self._imu.bias_sigma_radps)
        self._observed_ns = self._stamp_ns
        velocity_mps = T_last_camera[:3, 3] / elapsed_s
        share = elapsed_s / (elapsed_s + _SMOOTHING_S / 2)
        mean_mps = self._velocity_mps + share * (velocity_mps - self._velocity_mps)
        self._velocity_mps = T_last_camera[:3, :3].T @ mean_mps
        weight = min(elapsed_s / _SPREAD_S, 1.0)
        self._variance_m2ps2 += weight * (float(mean_mps @ mean_mps) / 3 - self._variance_m2ps2)
        self._imu.observe(self._start_ns, self._stamp_ns, T_last_camera)

    def predict(self) -> FloatArray | None:
        """Return T_camera_last (4, 4); None without rotation by the gyro or elapsed time."""
        rotation = self._rotation()
        return None if rotation is None else se3.inverse(self._motion(rotation))

    def rate_radps(self, stamp_ns: int) -> FloatArray | None:
        """Return the camera's turn rate (3,) about its own axes at an image; None if unknown."""
        half_ns = _RATE_NS // 2
        turn = self._imu.rotation(stamp_ns - half_ns, stamp_ns + half_ns)
        return (
            None if turn is None else rotation_vector(turn.R_first_second) / (S_PER_NS * _RATE_NS)
        )

    def rotation_prior(self) -> MeasuredRotation | None:
        """Return the rotation since the last tracked image by a filtered attitude, if known.

        The filtered attitude is an average, to which that image contributes only a part.
        """
        correction, rotation = self._attitude.R_tracked_filtered, self._rotation()
        if correction is None or rotation is None or not self._imu.gives_prior:
            return None
        sigma_rad = math.hypot(self._attitude.sigma_rad, rotation.sigma_rad)
        return MeasuredRotation(correction @ rotation.R_first_second, sigma_rad)

    def bridge(self) -> BridgedMotion | None:
        """Return the predicted motion with its covariances; None if unknown or after 1.5 s."""
        rotation = self._rotation() if self._elapsed_s <= _MAX_BRIDGE_S else None
        if rotation is None:
            return None
        step_s = min(S_PER_NS * self._step_ns, self._elapsed_s)
        angle, share = rotation.sigma_rad**2, step_s / self._elapsed_s
        position, step = (self._position_variance_m2(s) for s in (self._elapsed_s, step_s))
        reckoned = self._reckon()
        if reckoned is not None:
            position = self._reckoned_variance_m2(reckoned)
            step = float(reckoned.speed_variances_m2ps2[0]) * step_s**2
        return BridgedMotion(
            self._motion(rotation),
            np.diag([angle] * 3 + [position] * 3),
            np.diag([share * angle] * 3 + [step / 2] * 3),
            self._elapsed_s,
            _SOURCE,
            is_short=True,
        )

    def _rotation(self) -> MeasuredRotation | None:
        """Return the measured rotation since the last tracked image; None if it is unknown.

        The gyro's recent error is added to the standard deviation, because such errors persist.
        """
        stamps_ns = self._start_ns, self._stamp_ns
        if self._turn[0] != stamps_ns:
            turn = self._imu.rotation(*stamps_ns)
            if turn is not None:
                of_rate = self._attitude.rate_sigma_radps * self._elapsed_s
                turn = turn._replace(sigma_rad=math.hypot(turn.sigma_rad, of_rate))
            self._turn = stamps_ns, turn
        return self._turn[1]

    def _motion(self, rotation: MeasuredRotation) -> FloatArray:
        T = np.eye(4)
        T[:3, :3] = rotation.R_first_second
        reckoned = self._reckon()
        if reckoned is not None:
            T[:3, 3] = reckoned.positions_m[0]
        else:
            T[:3, 3] = _DECAY_S * -np.expm1(-self._elapsed_s / _DECAY_S) * self._velocity_mps
        return T

    def _reckon(self) -> Reckoned | None:
        """Return the position by the accelerometer; None if the last velocity is more accurate."""
        stamps_ns = self._start_ns, self._stamp_ns
        if self._elapsed_s < _LEAST_RECKONED_S:
            return None
        if stamps_ns != self._reckoned[0]:
            self._reckoned = stamps_ns, self._imu.position(*stamps_ns)
        reckoned, limit_m2 = self._reckoned[1], self._position_variance_m2(self._elapsed_s)
        is_better = reckoned is not None and self._reckoned_variance_m2(reckoned) <= limit_m2
        return reckoned if is_better else None

    def _reckoned_variance_m2(self, reckoned: Reckoned) -> float:
        """Return the variance of a position along each axis, with that from errors of the gyro.

        A growing attitude error makes gravity look like an acceleration sideways.
        """
        of_turn_m = GRAVITY_MPS2 * self._attitude.rate_sigma_radps * self._elapsed_s**3 / 6
        return float(reckoned.variances_m2[0]) + of_turn_m**2

    def _position_variance_m2(self, elapsed_s: float) -> float:
        """Return the position variance along each axis of an Ornstein-Uhlenbeck velocity."""
        kept = np.exp(-elapsed_s / _DECAY_S)
        spread_s2 = 2 * _DECAY_S * elapsed_s - _DECAY_S**2 * (3 - 4 * kept + kept**2)
        return float(self._variance_m2ps2 * max(spread_s2, 0.0))

    @property
    def _elapsed_s(self) -> float:
        return S_PER_NS * (self._stamp_ns - self._start_ns)
