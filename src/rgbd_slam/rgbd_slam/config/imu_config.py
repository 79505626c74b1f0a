"""Parameters of an IMU, which is used if there is one."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ImuConfig(Config):
    """The use of a gyro and an accelerometer beside the camera."""

    gyro: bool = param(
        default=True,
        description='Whether a gyro predicts how the camera turns, and continues its pose for up '
        'to 1.5 s while images show too few map points. Set it to false if the gyro is useless; a '
        'gyro that contradicts the images is ignored in any case.',
        expert=True,
    )
    prior: bool = param(
        default=True,
        description='Whether the gyro also supports the rotation of tracked images, beside their '
        'features. Set it to false to let the features alone determine tracked poses. It has no '
        'effect without imu.gyro.',
        expert=True,
    )
    integrate: bool = param(
        default=True,
        description='Whether an accelerometer that agrees with the tracked motion continues the '
        'position while the gyro continues the rotation. Set it to false to continue the last '
        'velocity instead, which decays in 0.4 s. It has no effect without imu.gyro.',
        expert=True,
    )
    level: bool = param(
        default=True,
        description='Whether an accelerometer makes the map frame level: z points up also if the '
        'camera is tilted at the start. Set it to false to keep the map frame as the start gives '
        'it. A saved map keeps its own frame. It has no effect with frames.planar and '
        'frames.base.',
        expert=True,
    )
    calibration: str = param(
        '',
        'File camchain-imucam.yaml of Kalibr, whose T_cam_imu and timeshift_cam_imu of cam0 are '
        'used at first; the rotation counts as known to 0.3 degrees. If it is empty, the rotation '
        'is read from /tf_static and counts as known to 1 degree. In both cases the time offset '
        'is then estimated from the images; so is the rotation, if none is given or if the images '
        'contradict the given one.',
        expert=True,
    )
