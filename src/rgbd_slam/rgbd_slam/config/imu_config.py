"""Parameters of an IMU, which is used if IMU messages arrive."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ImuConfig(Config):
    """The use of a gyro and an accelerometer beside the camera."""

    gyro: bool = param(
        default=True,
        description='Whether a gyro predicts how the camera turns, and continues its pose for up '
        'to 1.5 s while tracking fails.',
        expert=True,
    )
    prior: bool = param(
        default=True,
        description='Whether the gyro also constrains the rotation of tracked poses.',
        expert=True,
    )
    integrate: bool = param(
        default=True,
        description='Whether an accelerometer continues the position while the gyro continues the '
        'rotation; otherwise the last velocity does.',
        expert=True,
    )
    level: bool = param(
        default=True,
        description="Whether an accelerometer makes the map frame's z point up, unless "
        'frames.planar and frames.base are set. A loaded map keeps its frame.',
        expert=True,
    )
    calibration: str = param(
        '',
        'File camchain-imucam.yaml of Kalibr with T_cam_imu and timeshift_cam_imu of cam0. If it '
        'is empty, the rotation is read from /tf_static. The images correct both.',
        expert=True,
    )
