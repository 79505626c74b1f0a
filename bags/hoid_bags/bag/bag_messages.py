"""Conversion of images, cameras, poses and IMU samples to messages of a bag, and back."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_bags.bag.stamps import header
from hoid_bags.storage import bag_types as types
from hoid_bags.storage.bag_types import Message, new_message
from hoid_bags.storage.static_transforms import vector
from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.messages import detection_fields, transform_from_msg
from hoid_common.values import CameraModel, Detections, FloatArray

CAMERA_FRAME = 'camera_color_optical_frame'
"""Frame of both images: depth is registered to color."""
IMU_FRAME = 'camera_imu_frame'
WORLD_FRAME = 'world'
"""Fixed frame of the ground truth."""


def image(stamp_ns: int, pixels: NDArray[Any], encoding: str) -> Message:
    """Return the sensor_msgs/Image of pixels (H, W) or (H, W, 3), in the frame of the camera.

    `encoding` is the field of the message, such as 'bgr8'. It is not checked against the pixels.
    """
    rows = np.ascontiguousarray(pixels)
    return new_message(
        types.IMAGE,
        header=header(stamp_ns, CAMERA_FRAME),
        height=rows.shape[0],
        width=rows.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.strides[0],
        data=rows.reshape(-1).view(np.uint8),
    )


def compressed_image(stamp_ns: int, data: bytes, format_: str) -> Message:
    """Return the sensor_msgs/CompressedImage of a JPEG, a PNG or compressed depth."""
    return new_message(
        types.COMPRESSED_IMAGE,
        header=header(stamp_ns, CAMERA_FRAME),
        format=format_,
        data=np.frombuffer(data, np.uint8),
    )


def camera_info(stamp_ns: int, camera: CameraModel) -> Message:
    """Return the sensor_msgs/CameraInfo of a camera whose images are not rectified."""
    distortion = camera.distortion or (0.0,) * 5
    whole = dict.fromkeys(('x_offset', 'y_offset', 'height', 'width'), 0)
    roi = new_message('sensor_msgs/msg/RegionOfInterest', **whole, do_rectify=False)
    return new_message(
        types.CAMERA_INFO,
        header=header(stamp_ns, CAMERA_FRAME),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model=camera.distortion_model,
        d=np.array(distortion, np.float64),
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([camera.matrix, np.zeros((3, 1))]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def pose_stamped(stamp_ns: int, T_world_camera: FloatArray) -> Message:
    """Return the geometry_msgs/PoseStamped of the camera's pose (4, 4) in the world frame."""
    rotation = se3.quat_xyzw_from_rotation(T_world_camera[:3, :3])
    pose = new_message(
        'geometry_msgs/msg/Pose',
        position=vector('Point', T_world_camera[:3, 3]),
        orientation=vector('Quaternion', rotation),
    )
    return new_message(types.POSE_STAMPED, header=header(stamp_ns, WORLD_FRAME), pose=pose)


def static_edges(message: Message) -> list[tuple[str, str, FloatArray]]:
    """Return the valid edges (parent, child, T_parent_child) of a tf2_msgs/TFMessage."""
    edges = []
    for edge in message.transforms:
        names = edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/')
        with suppress(MessageError):
            edges.append((*names, transform_from_msg(edge)))
    return edges


def extrinsics(message: Message) -> FloatArray:
    """Return T_to_from (4, 4) of a realsense2_camera_msgs/Extrinsics, such as `depth_to_color`."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = message.rotation.reshape(3, 3).T, message.translation
    return T


def imu(
    stamp_ns: int,
    acceleration_mps2: FloatArray | None = None,
    rate_radps: FloatArray | None = None,
    frame: str = IMU_FRAME,
) -> Message:
    """Return the sensor_msgs/Imu of acceleration (3,) and angular velocity (3,) of an IMU.

    The orientation, and a sensor whose argument is None, are marked as missing: the first entry
    of the covariance is -1.
    """
    unknown, zero = np.array([-1.0, *[0.0] * 8]), np.zeros(3)
    force = zero if acceleration_mps2 is None else acceleration_mps2
    rate = zero if rate_radps is None else rate_radps
    return new_message(
        types.IMU,
        header=header(stamp_ns, frame),
        orientation=vector('Quaternion', np.array([0.0, 0.0, 0.0, 1.0])),
        orientation_covariance=unknown,
        angular_velocity=vector('Vector3', rate),
        angular_velocity_covariance=unknown if rate_radps is None else np.zeros(9),
        linear_acceleration=vector('Vector3', force),
        linear_acceleration_covariance=unknown if acceleration_mps2 is None else np.zeros(9),
    )


def detection_array(detections: Detections, camera: CameraModel) -> Message:
    """Return the hoid_msgs/DetectionArray of ground-truth boxes in images of a camera."""
    rows = detection_fields(detections)
    return new_message(
        types.DETECTION_ARRAY,
        header=header(detections.stamp_ns, CAMERA_FRAME),
        image_width=camera.width_px,
        image_height=camera.height_px,
        inference_ms=0.0,
        detections=[new_message('hoid_msgs/msg/Detection', **row) for row in rows],
    )
