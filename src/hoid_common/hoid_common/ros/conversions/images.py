"""Conversion of color images, depth images and cameras; `io.images` decodes the pixels."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from builtin_interfaces.msg import Time
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from hoid_common.errors import MessageError, replaced_by
from hoid_common.io import images
from hoid_common.io.compression import compressed_images
from hoid_common.ros.conversions.arrays import bytes_field
from hoid_common.values import ByteArray, CameraModel, Float32Array

# Declared for rosbags, which does not copy the pixels: rclpy copies them twice, which takes 1 ms
# for a VGA image in each node that subscribes.
_HEADER = 'builtin_interfaces/Time stamp\nstring frame_id'
_IMAGE = (
    'std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n'
    'uint32 step\nuint8[] data'
)
# A type store of all messages would delay the start of a node by 0.1 s.
_TYPES = get_typestore(Stores.EMPTY)
_TYPES.register(get_types_from_msg(_HEADER, 'std_msgs/msg/Header'))
_TYPES.register(get_types_from_msg(_IMAGE, 'sensor_msgs/msg/Image'))


def camera_to_msg(camera: CameraModel, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera whose images are not rectified (R = I, P = [K 0])."""
    K = camera.matrix.ravel().tolist()
    P = np.hstack([camera.matrix, np.zeros((3, 1))]).ravel().tolist()
    distortion = list(camera.distortion) or [0.0] * 5
    return CameraInfo(
        header=header,
        height=camera.height_px,
        width=camera.width_px,
        distortion_model=camera.distortion_model,
        d=distortion,
        k=K,
        r=np.eye(3).ravel().tolist(),
        p=P,
    )


def color_from_msg(msg: images.RawImage | CompressedImage) -> ByteArray:
    if isinstance(msg, CompressedImage):
        return compressed_images.decode_compressed_color(msg.data, msg.format)
    return images.decode_color(msg)


def color_to_msg(image_bgr: ByteArray, header: Header) -> Image:
    return _image_to_msg(image_bgr, 'bgr8', header)


def mask_to_msg(mask: ByteArray, header: Header) -> Image:
    return _image_to_msg(mask, 'mono8', header)


def compressed_color_to_msg(image_bgr: ByteArray, header: Header, quality: int) -> CompressedImage:
    """Return the JPEG message of a (H, W, 3) uint8 BGR image; `quality` is 1 to 100."""
    jpeg = images.encode_jpeg(image_bgr, quality)
    return CompressedImage(header=header, format=images.JPEG_FORMAT, data=bytes_field(jpeg))


def depth_from_msg(
    msg: images.RawImage | CompressedImage, units_per_m: float = 0.0
) -> Float32Array:
    if isinstance(msg, CompressedImage):
        return compressed_images.decode_compressed_depth(msg.format, msg.data, units_per_m)
    return images.decode_depth(msg, units_per_m)


def depth_to_msg(depth_m: Float32Array, header: Header) -> Image:
    """Return the message of (H, W) depth in m: 16UC1 if all values are whole mm, else 32FC1."""
    depth_mm = images.depth_mm_or_none(depth_m)
    if depth_mm is None:
        return _image_to_msg(depth_m, '32FC1', header)
    return _image_to_msg(depth_mm, '16UC1', header)


def compressed_depth_to_msg(depth_m: Float32Array, header: Header) -> CompressedImage:
    """Return the compressedDepth message of depth (H, W) in m; MessageError if not whole mm."""
    depth_mm = images.depth_mm_or_none(depth_m)
    if depth_mm is None:
        raise MessageError('depth is not in whole millimeters; send it raw to keep it exact')
    return CompressedImage(
        header=header,
        format=images.COMPRESSED_DEPTH_FORMAT,
        data=bytes_field(images.encode_compressed_depth(depth_mm)),
    )


def _image_to_msg(pixels: images.Pixels, encoding: str, header: Header) -> Image:
    return Image(
        header=header,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.itemsize * pixels.size // pixels.shape[0],
        data=bytes_field(pixels),
    )


@dataclass(frozen=True, eq=False)
class ReceivedImage(images.RawImage):
    """The fields of sensor_msgs/Image.

    `data` is a read-only view (N,) uint8 of the serialized bytes; its length is not checked.
    """

    header: Header


def image_from_cdr(serialized: bytes) -> ReceivedImage:
    """Return the sensor_msgs/Image in serialized bytes (CDR); MessageError if they are invalid."""
    problem = MessageError(f'{len(serialized)} bytes are no sensor_msgs/Image')
    with replaced_by(problem, SerdeError):
        image = cast(
            'Any', _TYPES.deserialize_cdr(memoryview(serialized), 'sensor_msgs/msg/Image')
        )
        stamp = Time(sec=image.header.stamp.sec, nanosec=image.header.stamp.nanosec)
    pixels = {field.name: getattr(image, field.name) for field in fields(images.RawImage)}
    return ReceivedImage(header=Header(stamp=stamp, frame_id=image.header.frame_id), **pixels)
