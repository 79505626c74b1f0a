"""Dead reckoning: the position of a camera without images, by integrated specific force.

Between the last tracked image (time 0) and a time t, the position p in the frame of that image is

    p(t) = p0 + v0 t - 0.5 g t^2 + S(t),

where S is the double integral of the measured specific force, rotated into this frame by the gyro,
and g is gravity upwards (the preintegration of Forster et al., T-RO 2017). The same equation holds
for the tracked images of the last second, at t < 0. They determine p0, v0 and g by linear least
squares, so that a tilt of g and a constant bias of the accelerometer hardly matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.inertial.gravity import GRAVITY_MPS2
from rgbd_slam.inertial.rotations import cauchy_weights, rotation_vector

# Chosen: tracked positions of this time before the last tracked image are used. With 1 s, the
# error after 1 s of dead reckoning grows by a third; with 0.6 s it doubles.
_WINDOW_S = 1.5
WINDOW_NS = round(_WINDOW_S * NS_PER_S)
_MIN_IMAGES, _MIN_WINDOW_S = 8, 0.3  # chosen: fewer positions do not determine the velocity
# Chosen: a trial predicts positions that were tracked over 1 s. Up to five trials start at images
# 0.5 s apart. The accelerometer is used after three trials, that is, 2.3 s of tracked images.
_TRIAL_S, _TRIAL_STEP_S, _NUM_TRIALS, _MIN_TRIALS = 1.0, 0.5, 5, 3
TRIED_NS = 9 * NS_PER_S // 2  # chosen: duration of the trials and of the positions before them
_LEAST_M = 0.002  # chosen: smallest standard deviation of a tracked position
# Chosen: factor on the variance, because tracking errors of successive images are correlated.
_CORRELATED = 4.0
_ROUNDS = 3  # rounds of robust weighting; not tuned
_CAUCHY = 2.0  # chosen: a position with this multiple of the median residual has half the weight
# Median length of a vector of three normally distributed numbers with variance 1.
_MEDIAN_LENGTH = 1.54
# Chosen: limit for the estimated length of gravity; cheap accelerometers are off by 0.2.
_MAX_LENGTH_ERROR_MPS2 = 0.5
# Chosen: largest difference of the estimated gravity from the measured one, in sigmas.
_NUM_SIGMAS = 3.0
# Chosen: errors per radian of rotation: of the acceleration (m/s^2), because bias and mounting
# error turn with the camera; of the position (m), because the accelerometer is not at the camera's
# center.
_TURNED_MPS2, _LEVER_M = 0.1, 0.03
_NOISE_MPS15 = 0.01  # chosen: noise density (m/s^1.5), ten times that of a cheap accelerometer


class Reckoned(NamedTuple):
    """M positions of the camera by dead reckoning, with their variances along each axis."""

    positions_m: FloatArray  # (M, 3)
    variances_m2: FloatArray  # (M,)
    speed_variances_m2ps2: FloatArray  # (M,)


class Path(NamedTuple):
    """The camera at N times, with tracked positions at the first K; all vectors in one frame."""

    times_s: FloatArray  # (N,)
    positions_m: FloatArray  # (K, 3)
    R: FloatArray  # (N, 3, 3) rotation of the IMU since the first time; only its angle is used
    velocity_mps: FloatArray  # (N, 3) integral of the specific force from the first time on
    moved_m: FloatArray  # (N, 3) double integral of the specific force from the first time on
    up: FloatArray  # (3,) measured direction opposite to gravity
    up_sigma_rad: float

    def trial_error(self) -> float | None:
        """Return the RMS error of dead reckoning in trials on tracked positions, in sigmas.

        It is None if there are too few trials, and infinite if tracked positions contradict
        gravity.
        """
        num_tracked, squares = len(self.positions_m), []
        times_s = self.times_s[:num_tracked]
        for start_s in times_s[-1] - _TRIAL_S - _TRIAL_STEP_S * np.arange(_NUM_TRIALS):
            origin = int(np.searchsorted(times_s, start_s, side='right')) - 1
            end = int(np.searchsorted(times_s, start_s + _TRIAL_S, side='right'))
            if not self._is_enough(origin):
                break
            found = self.reckoned(origin, slice(origin + 1, end))
            if found is None:
                return math.inf
            errors_m = found.positions_m - self.positions_m[origin + 1 : end]
            variances_m2 = 3 * (found.variances_m2 + 2 * _LEAST_M**2)
            squares.append(np.mean(np.square(errors_m).sum(axis=1) / variances_m2))
        return float(np.sqrt(np.mean(squares))) if len(squares) >= _MIN_TRIALS else None

    def reckoned(self, origin: int, later: slice, scale: float = 1.0) -> Reckoned | None:
        """Predict the positions of the frames `later` from the tracked ones up to frame `origin`.

        None if there are too few tracked frames before. The variances are multiplied by `scale`.
        """
        if not self._is_enough(origin):
            return None
        before = slice(self._first(origin), origin + 1)
        found = self._fit(origin, before)
        if found is None:
            return None
        values, covariance = found
        elapsed_s, moved_m = self._moved(origin, later)
        turn_rad = np.linalg.norm(rotation_vector(self.R[origin].T @ self.R[later]), axis=1)
        rows = np.vander(elapsed_s, 3, increasing=True) * [1.0, 1.0, -0.5]
        slopes = np.vander(elapsed_s, 2, increasing=True) * [1.0, -1.0]
        of_turn_m = np.hypot(0.5 * _TURNED_MPS2 * turn_rad * elapsed_s**2, _LEVER_M * turn_rad)
        of_noise_m2 = _NOISE_MPS15**2 * elapsed_s**3 / 3
        of_turn_mps = _TURNED_MPS2 * turn_rad * elapsed_s
        return Reckoned(
            rows @ values + moved_m,
            scale * (np.vecdot(rows @ covariance, rows) + of_noise_m2 + of_turn_m**2),
            scale * (np.vecdot(slopes @ covariance[1:, 1:], slopes) + of_turn_mps**2),
        )

    def _first(self, origin: int) -> int:
        return int(np.searchsorted(self.times_s, self.times_s[origin] - _WINDOW_S))

    def _is_enough(self, origin: int) -> bool:
        first = self._first(origin)
        is_long = origin > 0 and self.times_s[origin] - self.times_s[first] >= _MIN_WINDOW_S
        return bool(is_long and origin + 1 - first >= _MIN_IMAGES)

    def _moved(self, origin: int, part: slice) -> tuple[FloatArray, FloatArray]:
        """Return times (M,) in s and double integrals of force (M, 3), from frame `origin` on."""
        elapsed_s = self.times_s[part] - self.times_s[origin]
        moved_m = self.moved_m[part] - self.moved_m[origin]
        return elapsed_s, moved_m - elapsed_s[:, None] * self.velocity_mps[origin]

    def _fit(self, origin: int, before: slice) -> tuple[FloatArray, FloatArray] | None:
        """Return position, velocity, gravity as rows (3, 3), and the rows' covariance (3, 3)."""
        times_s, moved_m = self._moved(origin, before)
        positions_m = self.positions_m[before] - moved_m
        rows = np.vander(times_s, 3, increasing=True) * [1.0, 1.0, -0.5]
        gravity_mps2, sigma_mps2 = GRAVITY_MPS2 * self.up, GRAVITY_MPS2 * self.up_sigma_rad
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
            weight = cauchy_weights(length_m, _CAUCHY, _CAUCHY * _LEAST_M)
            variance_m2 = (typical_m / _MEDIAN_LENGTH) ** 2
        is_long = abs(float(np.linalg.norm(values[2])) - GRAVITY_MPS2) > _MAX_LENGTH_ERROR_MPS2
        if is_long or np.linalg.norm(values[2] - gravity_mps2) > _NUM_SIGMAS * sigma_mps2:
            return None
        return values, np.asarray(np.linalg.inv(normal), np.float64)
