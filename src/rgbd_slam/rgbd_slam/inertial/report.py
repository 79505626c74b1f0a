"""The calibration of an IMU that a run has estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.rotations import rotation_vector


@dataclass(frozen=True)
class ImuReport:
    """The calibration of an IMU, with the names of `summary.json`; None: unknown."""

    # The stamps of the IMU are later than those of the images by this time.
    time_offset_ms: float | None = None
    time_offset_sigma_ms: float | None = None
    # Rotation vector of R_camera_imu [deg].
    rotation_deg: tuple[float, ...] | None = None
    rotation_sigma_deg: float | None = None
    gyro_bias_radps: tuple[float, ...] | None = None  # along the axes of the IMU
    gyro_bias_sigma_radps: float | None = None
    up_sigma_deg: float | None = None  # standard deviation of the direction of gravity
    in_use: str = 'none'  # the sensors that are in use: gyro, accelerometer
    fault: str = ''  # which sensor is not used, and why
    problems: tuple[str, ...] = ()  # all problems that were reported
    samples_left_out: int = 0  # number of samples with values that no sensor can measure


def report_of(imu: Imu) -> ImuReport:
    """Return the calibration and the faults of an IMU as known so far; numbers are rounded."""
    fit, up = imu.fit, imu.up
    report = ImuReport(
        up_sigma_deg=None if up is None else round(math.degrees(up.sigma_rad), 3),
        in_use=imu.trust.in_use,
        fault=imu.trust.problem,
        problems=imu.trust.problems,
        samples_left_out=imu.num_impossible,
    )
    if fit is None:
        return report
    rotation_deg = np.rad2deg(rotation_vector(fit.R_camera_imu)).round(3)
    return replace(
        report,
        time_offset_ms=round(1e3 * fit.offset_s, 2),
        time_offset_sigma_ms=round(1e3 * fit.offset_sigma_s, 2),
        rotation_deg=tuple(rotation_deg.tolist()),
        rotation_sigma_deg=round(math.degrees(fit.rotation_sigma_rad), 3),
        gyro_bias_radps=tuple(fit.bias_radps.round(5).tolist()),
        gyro_bias_sigma_radps=round(fit.bias_sigma_radps, 5),
    )
