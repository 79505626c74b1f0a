"""Conversion of sensor_msgs/Imu."""

from __future__ import annotations

from typing import NamedTuple

from sensor_msgs.msg import Imu

from hoid_common.errors import MessageError
from hoid_common.ros.conversions.headers import stamp_from_msg


class ImuSample(NamedTuple):
    """One message of an IMU; a sensor that the message lacks is None."""

    stamp_ns: int
    rate_radps: tuple[float, float, float] | None  # about the axes of the frame of the message
    acceleration_mps2: tuple[float, float, float] | None  # along these axes


def imu_from_msg(msg: Imu) -> ImuSample:
    """Return the sample of a message.

    A negative first covariance marks a sensor as missing (sensor_msgs/Imu uses -1). A sensor whose
    three values are all zero counts as missing too: drivers that publish the sensors apart leave
    them zero, and no sensor measures that.

    Raises:
        MessageError: The message has neither sensor.
    """
    rate, force = msg.angular_velocity, msg.linear_acceleration
    has_rate = msg.angular_velocity_covariance[0] >= 0 and any((rate.x, rate.y, rate.z))
    has_force = msg.linear_acceleration_covariance[0] >= 0 and any((force.x, force.y, force.z))
    if not has_rate and not has_force:
        raise MessageError(
            'an IMU message has neither angular velocity nor acceleration; check its driver'
        )
    return ImuSample(
        stamp_from_msg(msg.header.stamp),
        (rate.x, rate.y, rate.z) if has_rate else None,
        (force.x, force.y, force.z) if has_force else None,
    )
