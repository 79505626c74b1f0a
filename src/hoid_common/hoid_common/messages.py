"""Conversion of messages to values, by the same code for messages of rclpy and of rosbags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.values import NS_PER_S, Detections, FloatArray

MAX_DETECTIONS = 1000
"""Largest number of boxes in a message. Chosen: COCO's evaluation uses 100."""


class ImuSample(NamedTuple):
    """The measurements of one IMU message; None for a sensor that the message does not contain."""

    stamp_ns: int
    # Angular velocity about the axes of the frame of the message.
    rate_radps: tuple[float, float, float] | None
    # Acceleration along these axes, gravity included.
    acceleration_mps2: tuple[float, float, float] | None


def stamp_from_msg(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def pose_from_msg(msg: Any) -> FloatArray:
    """Return T_a_b (4, 4) of a geometry_msgs/Pose of frame b in frame a; translation in m.

    MessageError if a value is not finite, or the norm of the quaternion is not between 0.5 and 2.
    """
    return _transform(msg.orientation, msg.position, 'pose')


def transform_from_msg(msg: Any) -> FloatArray:
    """Return T_parent_child (4, 4) of a TransformStamped message; errors as in `pose_from_msg`."""
    return _transform(msg.transform.rotation, msg.transform.translation, 'transform')


def imu_from_msg(msg: Any) -> ImuSample:
    """Return the sample of a sensor_msgs/Imu; MessageError if both sensors are missing.

    A sensor is taken as missing if its first covariance is negative, or if its three values are
    zero: drivers that publish the two sensors in separate messages leave the other one zero.
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


def detections_from_msg(msg: Any) -> Detections:
    """Return the boxes of a hoid_msgs/DetectionArray; MessageError if a size limit is exceeded."""
    boxes = msg.detections
    if len(boxes) > MAX_DETECTIONS:
        raise MessageError(f'detections has {len(boxes)} elements, more than {MAX_DETECTIONS}')
    xyxy = [(box.x_min, box.y_min, box.x_max, box.y_max) for box in boxes]
    return Detections(
        stamp_from_msg(msg.header.stamp),
        np.array(xyxy, np.float32).reshape(-1, 4),
        tuple(box.class_name for box in boxes),
        np.array([box.score for box in boxes], np.float32),
    )


def detection_fields(
    detections: Detections, class_names: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Yield the fields of hoid_msgs/Detection; `class_id` is an index of `class_names`, or -1."""
    ids = {name: i for i, name in enumerate(class_names)}
    boxes, scores = detections.boxes_xyxy_px.tolist(), detections.scores.tolist()
    for name, score, box in zip(detections.class_names, scores, boxes, strict=True):
        edges = zip(('x_min', 'y_min', 'x_max', 'y_max'), box, strict=True)
        yield {'class_name': name, 'class_id': ids.get(name, -1), 'score': score, **dict(edges)}


def _transform(rotation: Any, translation: Any, what: str) -> FloatArray:
    quat = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    position_m = np.array([translation.x, translation.y, translation.z])
    # Chosen limits: the norm of a valid quaternion is 1 but for rounding. Comparisons with NaN are
    # False, so that NaN is refused.
    if not (np.isfinite(position_m).all() and 0.5 < np.linalg.norm(quat) < 2.0):
        raise MessageError(
            f'{what} is no rigid transform: quaternion {quat.tolist()} at {position_m.tolist()}'
        )
    return se3.from_quat_translation(quat, position_m)
