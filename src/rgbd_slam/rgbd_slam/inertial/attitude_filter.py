"""A complementary filter of the camera's attitude, from gyro and tracked rotations."""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import FloatArray
from rgbd_slam.inertial.gyro_calibration import UNKNOWN_BIAS_RADPS
from rgbd_slam.inertial.rotations import rotation_vector, rotations

# Chosen: shortest time constant of the average of the tracked rotations. In this time, an error of
# 0.005 rad/s in the gyro's bias turns the attitude by 0.14 degrees. A prior that depends on the
# last image alone would keep an error in the rotation of that image.
_AVERAGING_S = 0.5
_LEAST_S = 0.1  # chosen: the filter has a result once it has averaged for this time
_SPREAD_S = 1.0  # chosen: time over which the scatter of the tracked rotations is measured
_INITIAL_SPREAD_RAD = np.deg2rad(0.5)  # chosen: scatter of the tracked rotations of blurred images
# Chosen: time over which rates of gyro and tracking are compared, to see whether the gyro has just
# become wrong. If it has been wrong for 0.1 s, the comparison shows half of its error, hence the
# factor.
_RECENT_S, _RECENT_FACTOR = 0.15, 2.0
# Chosen: factor on the variance, so that two sigmas count as noise of tracking.
_NOISE_FACTOR = 4.0
# Chosen: factor on the variance, because tracking errors of successive images are correlated.
_CORRELATED = 4.0
# Chosen: least standard deviation of a prior, for errors of stamps while the camera turns.
_LEAST_SIGMA_RAD = np.deg2rad(0.2)


class AttitudeFilter:
    """Averages the differences between tracked rotations and rotations measured by a gyro.

    This is a complementary filter (Mahony et al., TAC 2008). Its gain for the n-th image is 1 / n
    until the averaging time is reached. That time minimizes the error from tracking and bias: 0.5
    s, or longer while the tracked rotations scatter, as in blurred images or before a bare wall,
    where successive rotations share an error. The average is relative to the last tracked image,
    so that corrections of the map do not change it.
    """

    def __init__(self) -> None:
        self._R_filtered_tracked: FloatArray = np.eye(3)  # at the last tracked image
        # Variance of a tracked rotation about each axis, from its difference to the average.
        self._variance_rad2 = _INITIAL_SPREAD_RAD**2
        # Tracked minus gyro rotation between the last two images.
        self._difference_rad: FloatArray = np.zeros(3)
        # Tracked minus gyro rate, averaged over 0.15 s.
        self._difference_radps: FloatArray = np.zeros(3)
        # Variance of a tracked rotation about each axis, from the change between successive
        # differences, which contains three independent errors with the weights 1, -2 and 1.
        self._noise_rad2 = _INITIAL_SPREAD_RAD**2
        self._time_s = self._step_s = self._averaged_s = 0.0
        self._bias_sigma_radps = UNKNOWN_BIAS_RADPS

    def restart(self) -> None:
        """Drop the average, because the next tracked image does not continue the last one."""
        self._R_filtered_tracked = np.eye(3)
        self._time_s = self._averaged_s = 0.0

    def add(
        self,
        R_gyro: FloatArray | None,
        R_tracked: FloatArray,
        elapsed_s: float,
        bias_sigma_radps: float,
    ) -> None:
        """Add the rotation R_last_camera (3, 3) of the camera between two tracked images.

        Args:
            R_gyro: The rotation by the gyro; if it is None (unknown), the filter restarts.
            R_tracked: The tracked rotation.
            elapsed_s: Time between both images; the filter restarts if it is not positive.
            bias_sigma_radps: Standard deviation of the gyro's bias.
        """
        if R_gyro is None or elapsed_s <= 0:
            self.restart()
            return
        error_rad = rotation_vector(R_gyro.T @ self._R_filtered_tracked @ R_tracked)
        self._step_s, self._time_s = elapsed_s, self._time_s + elapsed_s
        share = min(elapsed_s / _SPREAD_S, 1.0)
        self._variance_rad2 += share * (float(error_rad @ error_rad) / 3 - self._variance_rad2)
        self._bias_sigma_radps = bias_sigma_radps
        self._averaged_s = min(self._time_s, self._averaging_s(elapsed_s))
        kept = 1.0 - min(elapsed_s / self._averaged_s, 1.0)
        self._R_filtered_tracked = rotations(kept * error_rad)
        self._compare_rates(rotation_vector(R_gyro.T @ R_tracked))

    def _compare_rates(self, difference_rad: FloatArray) -> None:
        """Update noise of tracking and recent error of the gyro by a rotation difference (3,)."""
        recent = math.exp(-self._step_s / _RECENT_S)
        share = min(self._step_s / _SPREAD_S, 1.0)
        change_rad = difference_rad - self._difference_rad  # the gyro's error cancels out
        self._noise_rad2 += share * (float(change_rad @ change_rad) / 18 - self._noise_rad2)
        self._difference_rad = difference_rad
        self._difference_radps *= recent
        self._difference_radps += (1.0 - recent) / self._step_s * difference_rad

    def _averaging_s(self, step_s: float) -> float:
        """Return the averaging time (s) that minimizes the variance `sigma_rad`^2."""
        variance_s = 2 * _CORRELATED * self._variance_rad2 * step_s
        return max(_AVERAGING_S, math.cbrt(variance_s / self._bias_sigma_radps**2))

    @property
    def R_tracked_filtered(self) -> FloatArray | None:  # noqa: N802
        """Return the correction (3, 3) of the last tracked rotation; None in the first 0.1 s."""
        return None if self._time_s < _LEAST_S else self._R_filtered_tracked.T

    @property
    def sigma_rad(self) -> float:
        """Return the standard deviation of the filtered attitude about each axis."""
        averaged_s = max(self._averaged_s, self._step_s)
        of_images = math.sqrt(_CORRELATED * self._variance_rad2 * self._step_s / averaged_s)
        return math.hypot(_LEAST_SIGMA_RAD, of_images, 0.5 * averaged_s * self._bias_sigma_radps)

    @property
    def rate_sigma_radps(self) -> float:
        """Return the recent error (rad/s) of the gyro's rates beyond the noise of tracking."""
        if self._step_s == 0.0:
            return 0.0
        gain_per_s = (1.0 - math.exp(-self._step_s / _RECENT_S)) / self._step_s
        of_noise = _NOISE_FACTOR * gain_per_s**2 * self._noise_rad2
        excess = float(self._difference_radps @ self._difference_radps) / 3 - of_noise
        return _RECENT_FACTOR * math.sqrt(max(excess, 0.0))
