"""A complementary filter of the attitude: gyro and tracked rotation."""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import FloatArray
from rgbd_slam.inertial.gyro_calibration import UNKNOWN_BIAS_RADPS
from rgbd_slam.inertial.rotations import rotation_vector, rotations

# Chosen: least time over which the tracked rotations are averaged. In this time, an error of 0.005
# rad/s in the bias of the gyro turns the attitude by 0.14 degrees. A prior that rests on the last
# image alone does harm: if the rotation of that image is wrong, the prior holds on to it.
_AVERAGING_S = 0.5
_LEAST_S = 0.1  # chosen: shortest time of averaging after which an attitude is given
_SPREAD_S = 1.0  # chosen: time over which the spread of the tracked rotations is measured
_INITIAL_SPREAD_RAD = np.deg2rad(0.5)  # chosen: spread of the rotations of blurred images
# Chosen: time over which gyro and tracked rotations are compared to see whether the gyro has just
# gone wrong. If the gyro has been wrong for 0.1 s, the comparison shows half of its error, hence
# the factor.
_RECENT_S, _RECENT_FACTOR = 0.15, 2.0
_NOISE_FACTOR = 4.0  # chosen: factor of the variance; two sigmas count as noise of tracking
_CORRELATED = 4.0  # chosen: factor of the variance, as errors of tracking last for some images
_LEAST_SIGMA_RAD = np.deg2rad(0.2)  # chosen: of a prior, for errors of stamps in turns


class AttitudeFilter:
    """Averages the differences between tracked rotations and rotations measured by a gyro.

    This is a complementary filter (Mahony et al., TAC 2008). Its gain for the n-th image is 1 / n
    until the averaging time is reached, which minimizes the error of tracking and bias: 0.5 s, or
    longer where the tracked rotations scatter, as in blurred images or before a bare wall. There,
    successive rotations share an error, which would bias a shorter average. The average is kept
    relative to the last tracked image, so that corrections of the map do not matter.
    """

    def __init__(self) -> None:
        self._R_filtered_tracked: FloatArray = np.eye(3)  # at the last tracked image
        self._variance_rad2 = _INITIAL_SPREAD_RAD**2  # of a tracked rotation about each axis
        self._difference_rad: FloatArray = np.zeros(3)  # of both rotations to the last image
        self._difference_radps: FloatArray = np.zeros(3)  # of both rates, averaged over 0.15 s
        # Variance of a tracked rotation about each axis. The change from one difference to the
        # next one has three independent errors, with the weights 1, -2 and 1.
        self._noise_rad2 = _INITIAL_SPREAD_RAD**2
        self._time_s = self._step_s = self._averaged_s = 0.0
        self._bias_sigma_radps = UNKNOWN_BIAS_RADPS

    def restart(self) -> None:
        """Forget the average, because the next tracked image does not continue the last one."""
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
        """Learn the noise of tracking and the recent error of the gyro from a difference (3,)."""
        recent = math.exp(-self._step_s / _RECENT_S)
        share = min(self._step_s / _SPREAD_S, 1.0)
        change_rad = difference_rad - self._difference_rad  # the error of the gyro cancels
        self._noise_rad2 += share * (float(change_rad @ change_rad) / 18 - self._noise_rad2)
        self._difference_rad = difference_rad
        self._difference_radps *= recent
        self._difference_radps += (1.0 - recent) / self._step_s * difference_rad

    def _averaging_s(self, step_s: float) -> float:
        """Return the averaging time [s] that minimizes the variance in `sigma_rad`."""
        variance_s = 2 * _CORRELATED * self._variance_rad2 * step_s
        return max(_AVERAGING_S, math.cbrt(variance_s / self._bias_sigma_radps**2))

    @property
    def R_tracked_filtered(self) -> FloatArray | None:  # noqa: N802
        """Return the correction (3, 3) of the last tracked rotation; None before 0.1 s."""
        return None if self._time_s < _LEAST_S else self._R_filtered_tracked.T

    @property
    def sigma_rad(self) -> float:
        """Return the standard deviation of the filtered attitude about each axis."""
        averaged_s = max(self._averaged_s, self._step_s)
        of_images = math.sqrt(_CORRELATED * self._variance_rad2 * self._step_s / averaged_s)
        return math.hypot(_LEAST_SIGMA_RAD, of_images, 0.5 * averaged_s * self._bias_sigma_radps)

    @property
    def rate_sigma_radps(self) -> float:
        """Return the error of the gyro's rates beyond the noise of the last tracked images."""
        if self._step_s == 0.0:
            return 0.0
        gain_per_s = (1.0 - math.exp(-self._step_s / _RECENT_S)) / self._step_s
        of_noise = _NOISE_FACTOR * gain_per_s**2 * self._noise_rad2
        excess = float(self._difference_radps @ self._difference_radps) / 3 - of_noise
        return _RECENT_FACTOR * math.sqrt(max(excess, 0.0))
