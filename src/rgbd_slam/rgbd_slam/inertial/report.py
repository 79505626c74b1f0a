"""The calibration of an IMU, as a run has found it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgbd_slam.inertial.gyro_integral import rotation_vector
from rgbd_slam.inertial.imu import Imu


@dataclass(frozen=True)
class ImuReport:
    """The calibration of an IMU, with the names of `summary.json`.

    A value is None if it is not known; `fault` is '' if there is none.
    """

    time_offset_ms: float | None = None  # by which its stamps are later than those of the images
    time_offset_sigma_ms: float | None = None
    # Rotation vector of R_camera_imu [deg].
    rotation_deg: tuple[float, ...] | None = None
    rotation_sigma_deg: float | None = None
    gyro_bias_radps: tuple[float, ...] | None = None  # along the axes of the IMU
    gyro_bias_sigma_radps: float | None = None
    up_sigma_deg: float | None = None  # standard deviation of the direction of gravity
    fault: str = ''  # why the gyro is left out
    samples_left_out: int = 0  # because no sensor measures that


def report_of(imu: Imu) -> ImuReport:
    """Return the calibration and the fault of an IMU as known so far; numbers are rounded."""
    fit, up = imu.fit, imu.up
    up_sigma_deg = None if up is None else round(float(np.rad2deg(up.sigma_rad)), 3)
    if fit is None:
        return ImuReport(
            up_sigma_deg=up_sigma_deg, fault=imu.problem, samples_left_out=imu.num_impossible
        )
    turn_deg = np.rad2deg(rotation_vector(fit.R_camera_imu))
    return ImuReport(
        round(1e3 * fit.offset_s, 2),
        round(1e3 * fit.offset_sigma_s, 2),
        tuple(round(value, 3) for value in turn_deg.tolist()),
        round(float(np.rad2deg(fit.rotation_sigma_rad)), 3),
        tuple(round(value, 5) for value in fit.bias_radps.tolist()),
        round(fit.bias_sigma_radps, 5),
        up_sigma_deg,
        imu.problem,
        imu.num_impossible,
    )
