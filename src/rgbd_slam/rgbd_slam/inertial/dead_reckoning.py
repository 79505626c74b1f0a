"""Dead reckoning: the position of a camera without images, by integrated specific force.

Between the last tracked image (time 0) and a time t, the position p in the frame of that image is

    p(t) = p0 + v0 t - 0.5 g t^2 + S(t),

where S is the double integral of the measured specific force, turned into this frame by the gyro,
and g is gravity upwards (the preintegration of Forster et al., T-RO 2017). The same equation holds
for the tracked images of the last second, at t < 0. They determine p0, v0 and g by linear least
squares. The tilt of g and a constant bias of the accelerometer thus hardly matter.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray
from rgbd_slam.inertial.force_integral import ForceIntegral
from rgbd_slam.inertial.gravity import GRAVITY_MPS2
from rgbd_slam.inertial.imu import Imu

# Chosen: time before the last tracked image whose positions are used. With 1 s, the errors of
# 1 s of dead reckoning grow by a third, with 0.6 s they double.
_WINDOW_S = 1.5
_MIN_IMAGES, _MIN_WINDOW_S = 8, 0.3  # chosen: fewer positions do not determine the velocity
# Chosen: a trial predicts tracked positions over this time; trials begin at images that are this
# time apart. There must be three to use the accelerometer, that is, 2.3 s of tracked images.
_TRIAL_S, _TRIAL_STEP_S, _NUM_TRIALS, _MIN_TRIALS = 1.0, 0.5, 5, 3
# Chosen: RMS of the errors of the trials, in standard deviations, above which an accelerometer is
# not used. A good one has 0.3 to 1.3; faulty ones have 3 and more as long as the camera moves.
_MAX_ERROR = 2.0
_KEPT_NS = 9 * NS_PER_S // 2  # chosen: time of the trials and of the positions before them
_LEAST_M = 0.002  # chosen: smallest standard deviation of a tracked position
_CORRELATED = 4.0  # chosen: factor of the variance, as errors of tracking last for some images
_ROUNDS = 3  # of robust weights; not tuned
_CAUCHY = 2.0  # chosen: positions with residuals of this multiple of the median weigh half
_MEDIAN_LENGTH = 1.54  # of a vector of three normally distributed numbers with the variance 1
_DRIFT_RAD = np.deg2rad(1.0)  # chosen: error of a direction that was tracked for 2 s
_MAX_LENGTH_ERROR_MPS2 = 0.5  # chosen: of gravity; the scale of cheap accelerometers is off by 0.2
_NUM_SIGMAS = 3.0  # chosen: by which gravity may differ from what was measured before
# Chosen: what a turn by one radian changes: the bias and the error of the mounting turn with the
# camera [m/s^2], and the accelerometer is not at the center of the camera [m].
_TURNED_MPS2, _LEVER_M = 0.1, 0.03
_NOISE_MPS15 = 0.01  # chosen: ten times the density of a cheap accelerometer [m/s^1.5]


class Reckoned(NamedTuple):
    """The position of the camera in the frame of the last tracked image."""

    position_m: FloatArray  # (3,)
    variance_m2: float  # along each axis
    speed_variance_m2ps2: float  # of the velocity, along each axis


class _Up(NamedTuple):
    """The prior of gravity in the frame of the last tracked image."""

    direction: FloatArray  # (3,) unit vector
    sigma_rad: float


class DeadReckoning:
    """Continues the position of a camera from the tracked poses of the last seconds.

    Before, the same is tried from images of the last 3 s, each for one second in which the tracked
    positions are known. An accelerometer that does not predict these is not used.

    Args:
        imu: The IMU.
    """

    def __init__(self, imu: Imu) -> None:
        self._imu = imu
        self._stamps_ns: deque[int] = deque()
        self._T_chain_camera: deque[FloatArray] = deque()
        # Stamp of the image from which the latest trials were made, and the RMS of their errors in
        # standard deviations; None: there were too few trials, inf: gravity contradicts one.
        self._tried: tuple[int, float | None] = (0, None)

    def add(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Add the tracked motion (4, 4) between two images.

        If `first_ns` is not the stamp of the last image, all earlier motions are dropped.
        """
        if not self._stamps_ns or first_ns != self._stamps_ns[-1]:
            self._stamps_ns, self._T_chain_camera = deque([first_ns]), deque([np.eye(4)])
        self._stamps_ns.append(second_ns)
        self._T_chain_camera.append(se3.orthonormalized(self._T_chain_camera[-1] @ T_first_second))
        while self._stamps_ns[0] < second_ns - _KEPT_NS:
            self._stamps_ns.popleft()
            self._T_chain_camera.popleft()

    def position(self, last_ns: int, stamp_ns: int) -> Reckoned | None:
        """Return the position at a time after the last tracked image.

        None is returned if too few images have been tracked without interruption up to that one,
        if the IMU gives no forces (`Imu.forces`) or no direction of gravity, or if the
        accelerometer contradicts the tracked positions.

        Args:
            last_ns: Stamp of the last tracked image.
            stamp_ns: Stamp up to which the position is continued.
        """
        up = self._up()
        if up is None or self._stamps_ns[-1] != last_ns:
            return None
        error = self._error(up)
        if error is None or error > _MAX_ERROR:
            return None
        before = self._tracked().between(-_WINDOW_S)
        first_ns = self._stamps_ns[-len(before.times_s)]
        forces = self._imu.forces(first_ns, last_ns, stamp_ns)
        elapsed_s = np.array([S_PER_NS * (stamp_ns - last_ns)])
        found = None if forces is None else _continued(forces, before, up, elapsed_s)
        if found is None:
            return None
        scale = max(error, 1.0) ** 2
        return Reckoned(
            found.positions_m[0],
            scale * float(found.variances_m2[0]),
            scale * float(found.speed_variances_m2ps2[0]),
        )

    def agrees(self) -> bool | None:
        """Return whether dead reckoning by the accelerometer agrees with the last 3 s of tracking.

        None is returned if it cannot be tried: after less than 2.3 s of tracking without
        interruption, or if the IMU gives no forces or no direction of gravity.
        """
        up = self._up()
        error = None if up is None else self._error(up)
        return None if error is None else error <= _MAX_ERROR

    def _error(self, up: _Up) -> float | None:
        """Return the result of `_trials` at the last image, which is computed once per image."""
        last_ns = self._stamps_ns[-1]
        if self._tried[0] != last_ns:
            self._tried = last_ns, self._trials(up)
        return self._tried[1]

    def _up(self) -> _Up | None:
        """Return the measured direction of gravity, turned into the frame of the last image."""
        up = self._imu.up
        if up is None or up.stamp_ns not in self._stamps_ns:
            return None
        then = self._T_chain_camera[self._stamps_ns.index(up.stamp_ns)]
        R = self._T_chain_camera[-1][:3, :3].T @ then[:3, :3]
        return _Up(R @ up.up_camera, float(np.hypot(up.sigma_rad, _DRIFT_RAD)))

    def _trials(self, up: _Up) -> float | None:
        """Return the RMS of the errors of trials in standard deviations; None: too few trials.

        It is infinite if the positions before a trial contradict gravity.
        """
        last_ns = self._stamps_ns[-1]
        forces = self._imu.forces(self._stamps_ns[0], last_ns, last_ns)
        if forces is None:
            return None
        tracked, squares = self._tracked(), []
        for origin_s in -_TRIAL_S - _TRIAL_STEP_S * np.arange(_NUM_TRIALS):
            before = tracked.between(origin_s - _WINDOW_S, origin_s)
            known = tracked.between(origin_s, origin_s + _TRIAL_S)
            if not (before.is_enough and len(known.times_s)):
                break
            found = _continued(forces, before, up, known.times_s)
            if found is None:
                return math.inf
            square_m2 = np.square(found.positions_m - known.positions_m).sum(axis=1)
            squares.append(np.mean(square_m2 / (3 * (found.variances_m2 + 2 * _LEAST_M**2))))
        return float(np.sqrt(np.mean(squares))) if len(squares) >= _MIN_TRIALS else None

    def _tracked(self) -> _Path:
        """Return the tracked positions of the last seconds in the frame of the last image."""
        times_s = S_PER_NS * (np.array(self._stamps_ns) - self._stamps_ns[-1])
        positions_m = np.stack(self._T_chain_camera)[:, :3, 3]
        last = self._T_chain_camera[-1]
        return _Path(times_s, (positions_m - last[:3, 3]) @ last[:3, :3])


class _Path(NamedTuple):
    """Tracked positions."""

    times_s: FloatArray  # (K,) since the last image, and thus not positive
    positions_m: FloatArray  # (K, 3) in the frame of the last image

    def between(self, from_s: float, to_s: float = 0.0) -> _Path:
        """Return the positions between two times since the last image."""
        is_within = (self.times_s >= from_s) & (self.times_s <= to_s)
        return _Path(self.times_s[is_within], self.positions_m[is_within])

    @property
    def is_enough(self) -> bool:
        """Whether the positions determine a velocity."""
        return bool(len(self.times_s) >= _MIN_IMAGES and np.ptp(self.times_s) >= _MIN_WINDOW_S)


class _Continued(NamedTuple):
    """Positions by dead reckoning; variances are those along each axis."""

    positions_m: FloatArray  # (M, 3)
    variances_m2: FloatArray  # (M,)
    speed_variances_m2ps2: FloatArray  # (M,)


def _continued(
    forces: ForceIntegral, before: _Path, up: _Up, later_s: FloatArray
) -> _Continued | None:
    """Return the positions of the camera after the known ones, by dead reckoning.

    None is returned if too few positions are known, or if they contradict gravity.

    Args:
        forces: Integrals over all times.
        before: The known positions; from the last one on, the position is continued.
        up: The prior of gravity.
        later_s: (M,) times after the last known position.
    """
    if not before.is_enough:
        return None
    origin_s = float(before.times_s[-1])
    moved_m = forces.moved_m(before.times_s, origin_s)
    found = _fit(before.times_s - origin_s, before.positions_m - moved_m, up)
    if found is None:
        return None
    values, covariance = found
    elapsed_s, turn_rad = later_s - origin_s, forces.turns_rad(later_s, origin_s)
    rows = np.vander(elapsed_s, 3, increasing=True) * [1.0, 1.0, -0.5]
    slopes = np.vander(elapsed_s, 2, increasing=True) * [1.0, -1.0]
    of_turn_m = np.hypot(0.5 * _TURNED_MPS2 * turn_rad * elapsed_s**2, _LEVER_M * turn_rad)
    of_noise_m2 = _NOISE_MPS15**2 * elapsed_s**3 / 3
    of_turn_mps = _TURNED_MPS2 * turn_rad * elapsed_s
    return _Continued(
        rows @ values + forces.moved_m(later_s, origin_s),
        np.vecdot(rows @ covariance, rows) + of_noise_m2 + of_turn_m**2,
        np.vecdot(slopes @ covariance[1:, 1:], slopes) + of_turn_mps**2,
    )


def _fit(
    times_s: FloatArray, positions_m: FloatArray, up: _Up
) -> tuple[FloatArray, FloatArray] | None:
    """Return position, velocity and gravity (3, 3), one row each, and their covariance (3, 3).

    The covariance is the same along each axis. None is returned if gravity contradicts `up`.

    Args:
        times_s: (K,) times since the origin, which are not positive.
        positions_m: (K, 3) without the integrals of the specific force.
        up: The prior of gravity.
    """
    rows = np.vander(times_s, 3, increasing=True) * [1.0, 1.0, -0.5]
    gravity_mps2, sigma_mps2 = GRAVITY_MPS2 * up.direction, GRAVITY_MPS2 * up.sigma_rad
    prior, prior_rhs = np.zeros((3, 3)), np.zeros((3, 3))
    prior[2, 2], prior_rhs[2] = 1.0 / sigma_mps2**2, gravity_mps2 / sigma_mps2**2
    variance_m2, weight = _LEAST_M**2, np.ones(len(times_s))
    values = normal = np.zeros((3, 3))
    for _ in range(_ROUNDS):
        weighted = weight[:, None] * rows / (_CORRELATED * variance_m2)
        normal = np.asarray(weighted.T @ rows + prior)
        values = np.asarray(np.linalg.solve(normal, weighted.T @ positions_m + prior_rhs))
        length_m = np.linalg.norm(positions_m - rows @ values, axis=1)
        typical_m = max(float(np.median(length_m)), _LEAST_M)
        weight = 1.0 / (1.0 + np.square(length_m / (_CAUCHY * typical_m)))
        variance_m2 = (typical_m / _MEDIAN_LENGTH) ** 2
    is_long = abs(float(np.linalg.norm(values[2])) - GRAVITY_MPS2) > _MAX_LENGTH_ERROR_MPS2
    if is_long or np.linalg.norm(values[2] - gravity_mps2) > _NUM_SIGMAS * sigma_mps2:
        return None
    return values, np.asarray(np.linalg.inv(normal), np.float64)
