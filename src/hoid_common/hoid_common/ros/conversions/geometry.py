"""Conversions of headers, poses, transforms, twists and odometry.

Twists and covariances have the rotation first, as in GTSAM; ROS messages have the translation
first. Only this module converts between the two orders.
"""

from __future__ import annotations

from math import sqrt
from operator import itemgetter

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    TransformStamped,
    Twist,
    Vector3,
)
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.messages import pose_from_msg
from hoid_common.values import NS_PER_S, FloatArray

_ROS_ORDER = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])  # the permutation is its own inverse


def point_to_msg(xyz: FloatArray) -> Point:
    x, y, z = xyz.tolist()
    return Point(x=x, y=y, z=z)


def vector_to_msg(xyz: FloatArray) -> Vector3:
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


def pose_to_msg(T_a_b: FloatArray) -> Pose:
    return Pose(position=point_to_msg(T_a_b[:3, 3]), orientation=_quaternion(T_a_b))


def pose_with_sigmas_from_msg(msg: PoseWithCovariance) -> tuple[FloatArray, float, float]:
    """Return T_a_b (4, 4), and the largest standard deviation of position [m] and rotation [rad].

    MessageError if the pose is no rigid transform, or a variance is negative or not finite.
    """
    variances = np.array(msg.covariance).reshape(6, 6).diagonal()
    if not (np.isfinite(variances) & (variances >= 0)).all():
        raise MessageError(f'pose has negative or infinite variances: {variances.tolist()}')
    sigma_m, sigma_rad = np.sqrt(variances.reshape(2, 3).max(axis=1)).tolist()
    return pose_from_msg(msg.pose), sigma_m, sigma_rad


def transform_to_msg(
    T_parent_child: FloatArray, stamp_ns: int, parent: str, child: str
) -> TransformStamped:
    msg = TransformStamped(child_frame_id=child)
    msg.header.stamp = stamp_to_msg(stamp_ns)
    msg.header.frame_id = parent
    msg.transform.translation = vector_to_msg(T_parent_child[:3, 3])
    msg.transform.rotation = _quaternion(T_parent_child)
    return msg


def twist_to_msg(twist: FloatArray) -> Twist:
    """Return the message of a twist (6,): angular velocity in rad/s, then linear in m/s."""
    return Twist(linear=vector_to_msg(twist[3:]), angular=vector_to_msg(twist[:3]))


def odometry_to_msg(
    T_odom_base: FloatArray,
    covariance: FloatArray,
    twist: FloatArray,
    twist_covariance: FloatArray,
    header: Header,
    child_frame_id: str,
) -> Odometry:
    """Return the Odometry message of the pose and velocity of the robot's base.

    `covariance` (6, 6) of the pose is along the axes of the base (rad², m²), and rotated here to
    those of the odometry frame. `twist` (6,) is in the base frame: angular velocity in rad/s, then
    linear in m/s, and so is its covariance.
    """
    A = np.kron(np.eye(2), T_odom_base[:3, :3])
    rotated = (A @ covariance @ A.T)[_ROS_ORDER]
    msg = Odometry(header=header, child_frame_id=child_frame_id)
    msg.pose.pose = pose_to_msg(T_odom_base)
    msg.pose.covariance = rotated.ravel()
    msg.twist.twist = twist_to_msg(twist)
    msg.twist.covariance = twist_covariance[_ROS_ORDER].ravel()
    return msg


def _quaternion(T: FloatArray) -> Quaternion:
    """Return the quaternion of a transform (4, 4).

    `se3.quat_xyzw_from_rotation` takes 20 times as long for a single rotation, and three rotations
    are converted per image.
    """
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3].tolist()
    trace = a + e + i
    # Each quaternion is multiplied by 4 times one of its components (Shepperd, 1978).
    _, x, y, z, w = max(
        (1 + 2 * a - trace, 1 + 2 * a - trace, b + d, c + g, h - f),
        (1 + 2 * e - trace, b + d, 1 + 2 * e - trace, f + h, c - g),
        (1 + 2 * i - trace, c + g, f + h, 1 + 2 * i - trace, d - b),
        (1 + trace, h - f, c - g, d - b, 1 + trace),
        key=itemgetter(0),
    )
    norm = sqrt(x * x + y * y + z * z + w * w)
    return Quaternion(x=x / norm, y=y / norm, z=z / norm, w=w / norm)


def stamp_to_msg(stamp_ns: int) -> Time:
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    return Header(stamp=stamp_to_msg(stamp_ns), frame_id=frame_id)


def camera_frame(header: Header, default: str) -> str:
    """Return a header's frame, or else `default`, without slash; MessageError if both are ''."""
    frame: str = header.frame_id.lstrip('/') or default
    if not frame:
        raise MessageError(
            'frame_id is empty, so the camera has no place in TF: set it in the driver, or name '
            'the frame with the parameter input.camera_frame'
        )
    return frame
