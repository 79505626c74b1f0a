"""Faults of an IMU, shown by its samples or by comparison with the tracked rotation."""

from __future__ import annotations

from enum import Enum

import numpy as np

from hoid_common.values import NS_PER_S
from rgbd_slam.inertial.gyro_calibration import GyroFit, RecentRates
from rgbd_slam.inertial.sample_buffer import SampleBuffer, Samples

_LOOK_NS = NS_PER_S  # chosen: the time over which samples must not all be equal
_LATE_NS = NS_PER_S // 4  # chosen: more than any driver's delay and the offsets that are found
_MIN_SAMPLES = 20  # chosen: fewer equal samples may be a coincidence of coarse sensors
_SATURATED_RADPS = 0.9  # chosen: a rate that stays equal above it is the end of the range
_SATURATED_SAMPLES = 4  # chosen: noise makes as many equal samples rare below the end
_UNIT_TOLERANCE = 1.5  # chosen: factor around 180 / pi within which the unit is deg/s
_MIN_CORRELATION = 0.7  # chosen: below it, the rates are not those of the camera in another unit
_MIN_SIGNAL_RADPS = 0.1  # chosen: below it, the tracked rates are mostly noise
_MAX_UNEXPLAINED = 0.8  # chosen: share of the tracked rates that a good gyro leaves unexplained


class GyroFault(Enum):
    """Why a gyro is left out; the value says what is wrong and what to do."""

    STUCK = 'its values do not change; restart its driver'
    LATE = 'its samples are more than 0.25 s late or have stopped; check its driver and its clock'
    UNIT = 'its rates are in degrees per second instead of radians per second; correct its driver'
    MIRRORED = 'one of its axes points the wrong way (a left-handed frame); correct its driver'
    DISAGREES = 'it contradicts the rotation that the images show; check its unit, axes and clock'


def fault_of_samples(gyro: SampleBuffer, image_ns: int, offset_ns: int) -> GyroFault | None:
    """Return a fault that the samples themselves show, or None.

    Args:
        gyro: The samples.
        image_ns: Stamp of the latest image.
        offset_ns: Time by which the stamps of the IMU are later than those of the images.
    """
    newest_ns = gyro.newest_ns
    if newest_ns is None or newest_ns < image_ns + offset_ns - _LATE_NS:
        return GyroFault.LATE
    return GyroFault.STUCK if is_stuck(gyro) else None


def is_stuck(sensor: SampleBuffer) -> bool:
    """Return whether all samples of the last second are equal, which noise makes impossible."""
    newest_ns = sensor.newest_ns
    if newest_ns is None:
        return False
    latest = sensor.between(newest_ns - _LOOK_NS, newest_ns).values
    return len(latest) >= _MIN_SAMPLES and bool((latest == latest[0]).all())


def fault_of_fit(fit: GyroFit) -> GyroFault | None:
    """Return a fault that the comparison with the tracked rotation shows, or None.

    While the camera hardly turns, no fault is noticed.
    """
    if fit.signal_radps < _MIN_SIGNAL_RADPS:
        return None
    if fit.is_mirrored:
        return GyroFault.MIRRORED
    if _is_in_degrees(fit.scale, fit.correlation):
        return GyroFault.UNIT
    if fit.residual_radps > _MAX_UNEXPLAINED * fit.signal_radps:
        return GyroFault.DISAGREES
    return None


def fault_of_recent_rates(recent: RecentRates) -> GyroFault | None:
    """Return a fault that the rates of the last 2 s show, or None.

    Only another unit is noticed so early, and only while the camera turns. If the rates and the
    tracked rotation disagree in another way, the tracked rotation may be wrong as well, as in a
    blur.
    """
    is_turning = recent.signal_radps > _MIN_SIGNAL_RADPS
    if is_turning and _is_in_degrees(recent.scale, recent.correlation):
        return GyroFault.UNIT
    return None


def _is_in_degrees(scale: float, correlation: float) -> bool:
    in_degrees = np.rad2deg(1.0) * scale
    return correlation > _MIN_CORRELATION and 1 / _UNIT_TOLERANCE < in_degrees < _UNIT_TOLERANCE


def is_saturated(samples: Samples) -> bool:
    """Return whether a rate stays at the end of the gyro's range in four samples or more.

    It does if four successive samples of one axis are exactly equal, at more than 0.9 rad/s.
    """
    values = samples.values
    if len(values) < _SATURATED_SAMPLES:
        return False
    repeats = (values[1:] == values[:-1]) & (np.abs(values[1:]) > _SATURATED_RADPS)
    runs = np.lib.stride_tricks.sliding_window_view(repeats, _SATURATED_SAMPLES - 1, axis=0)
    return bool(runs.all(axis=-1).any())
