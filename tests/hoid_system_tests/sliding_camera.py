"""Bags of a camera that slides along a textured wall with exactly known motion."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage import bag_types
from hoid_bags.storage.bag_types import Message
from hoid_common import topics
from hoid_common.io import images
from hoid_common.values import ByteArray, CameraModel

CAMERA = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5)
PERIOD_NS = 33_333_333
_WALL_M = 2.0
_STEP_PX = 2
STEP_M = _STEP_PX * _WALL_M / CAMERA.fx_px  # from image to image
_JPEG_QUALITY = 95


def write_sliding(
    path: Path,
    start_ns: int,
    num_frames: int,
    direction_px: tuple[int, int],
    *,
    compressed: bool = False,
) -> None:
    """Write a bag of a sliding camera.

    Args:
        path: Folder of the bag.
        start_ns: Stamp of the first image.
        num_frames: Number of images, at 30 Hz.
        direction_px: Direction of the motion, such as (1, 0) for right or (0, 1) for down.
        compressed: Write JPEG and compressedDepth.
    """
    color_topic, depth_topic, type_name = image_topics(compressed)
    wall = _wall(num_frames)
    with BagWriter(path) as writer:
        writer.add_topic(topics.CAMERA_INFO, bag_types.CAMERA_INFO)
        writer.add_topic(color_topic, type_name)
        writer.add_topic(depth_topic, type_name)
        depth_mm = np.full((CAMERA.height_px, CAMERA.width_px), 1000 * _WALL_M, np.uint16)
        for i in range(num_frames):
            stamp_ns = start_ns + i * PERIOD_NS
            x, y = (_STEP_PX * i * step for step in direction_px)
            view = wall[y : y + CAMERA.height_px, x : x + CAMERA.width_px]
            pack = _packed if compressed else _raw
            color, depth = pack(stamp_ns, np.ascontiguousarray(view), depth_mm)
            info = bag_messages.camera_info(stamp_ns, CAMERA)
            writer.write(topics.CAMERA_INFO, stamp_ns, info)
            writer.write(depth_topic, stamp_ns, depth)
            writer.write(color_topic, stamp_ns, color)


def _raw(stamp_ns: int, view: ByteArray, depth_mm: NDArray[np.uint16]) -> tuple[Message, Message]:
    color = bag_messages.image(stamp_ns, view, 'bgr8')
    return color, bag_messages.image(stamp_ns, depth_mm, '16UC1')


def _packed(
    stamp_ns: int, view: ByteArray, depth_mm: NDArray[np.uint16]
) -> tuple[Message, Message]:
    jpeg = images.encode_jpeg(view, _JPEG_QUALITY)
    png = images.encode_compressed_depth(depth_mm)
    return (
        bag_messages.compressed_image(stamp_ns, jpeg, 'bgr8; jpeg compressed bgr8'),
        bag_messages.compressed_image(stamp_ns, png, images.COMPRESSED_DEPTH_FORMAT),
    )


def image_topics(compressed: bool) -> tuple[str, str, str]:
    """Return the topics of color and depth, and the type of both."""
    color, depth = topics.RGB_IMAGE, topics.DEPTH_IMAGE
    if not compressed:
        return color, depth, bag_types.IMAGE
    return topics.compressed(color), topics.compressed_depth(depth), bag_types.COMPRESSED_IMAGE


def _wall(num_frames: int) -> ByteArray:
    """Return a picture with corners everywhere, large enough for the whole motion."""
    motion_px = _STEP_PX * num_frames
    width, height = CAMERA.width_px + motion_px, CAMERA.height_px + motion_px
    noise = np.random.default_rng(5).integers(0, 255, (height // 5, width // 5, 3), np.uint8)
    wall = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(wall, np.uint8)
