"""Recordings as drivers and recorders leave them, small and synthetic, each with its result."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from backports import zstd
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage.bag_types import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    EXTRINSICS,
    IMAGE,
    RGBD,
    TF_MESSAGE,
    Message,
    new_message,
)
from hoid_bags.storage.static_transforms import static_transforms
from hoid_common import se3
from hoid_common.inputs.registration import Registration
from hoid_common.io import images
from hoid_common.values import CameraModel, Float32Array

from .ros1_bags import ros1_copy

CAMERA = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5)
NUM = 3
COLOR = np.full((48, 64, 3), (40, 80, 120), np.uint8)  # BGR
DEPTH_MM = (1000 + 7 * np.arange(48 * 64) % 1500).reshape(48, 64).astype(np.uint16)
DEPTH_M = (DEPTH_MM / 1000).astype(np.float32)
OWN = CameraModel(40, 30, 24.0, 24.0, 19.5, 14.5)  # camera of depth that is not registered
OWN_MM = (1000 + 5 * np.arange(30 * 40) % 900).reshape(30, 40).astype(np.uint16)
T_COLOR_DEPTH = se3.from_quat_translation(
    np.array([0.004, -0.006, 0.003, 1.0]), np.array([0.015, -0.001, 0.002])
)
MAPPED_M = Registration(OWN, CAMERA, T_COLOR_DEPTH)((OWN_MM / 1000).astype(np.float32))
C, D = '/camera/color/image_raw', '/camera/depth/image_raw'
CAMERA_OF_C = '/camera/color/camera_info'
OWN_FRAME = 'camera_depth_optical_frame'
READ = 'read'


class Topic(NamedTuple):
    """A topic whose messages are made by their stamp (ns)."""

    name: str
    type_name: str
    message: Callable[[int], Message]


class Variant(NamedTuple):
    """A recording: what is special, how it is written, and what comes of it."""

    group: str
    what: str
    write: Callable[[Path], Path]
    result: str = READ  # or the line with which it is refused, as far as it is the same everywhere
    depth_m: Float32Array = DEPTH_M


def raw(
    name: str, pixels: NDArray[Any], encoding: str, *, rows: int = 0, frame: str = ''
) -> Topic:
    """Return a topic of raw images; `rows` is the height if it is not that of the pixels."""

    def message(stamp_ns: int) -> Message:
        made = bag_messages.image(stamp_ns, pixels, encoding)
        made.height = rows or made.height
        made.header.frame_id = frame or made.header.frame_id
        return made

    return Topic(name, IMAGE, message)


def packed(name: str, data: bytes, format_: str) -> Topic:
    """Return a topic of compressed images."""
    return Topic(
        name, COMPRESSED_IMAGE, lambda ns: bag_messages.compressed_image(ns, data, format_)
    )


def info(name: str, camera: CameraModel = CAMERA) -> Topic:
    """Return a topic of camera_info."""
    return Topic(name, CAMERA_INFO, lambda ns: bag_messages.camera_info(ns, camera))


COLORS, DEPTHS, INFO = raw(C, COLOR, 'bgr8'), raw(D, DEPTH_MM, '16UC1'), info(CAMERA_OF_C)


def bag(*topics: Topic) -> Callable[[Path], Path]:
    """Return a function that writes a bag of topics."""

    def write(path: Path) -> Path:
        with BagWriter(path) as writer:
            for topic in topics:
                writer.add_topic(topic.name, topic.type_name)
            for i in range(NUM):
                stamp_ns = 10**9 + 33_000_000 * i
                for topic in reversed(topics):  # camera_info before images
                    writer.write(topic.name, stamp_ns, topic.message(stamp_ns))
        return path

    return write


def ros1(write: Callable[[Path], Path], compression: str) -> Callable[[Path], Path]:
    """Return a function that writes a ROS 1 bag."""
    return lambda path: ros1_copy(write(path), path.with_suffix('.bag'), compression)


def png(pixels: NDArray[Any]) -> bytes:
    return cv2.imencode('.png', pixels)[1].tobytes()


def tiff(pixels: NDArray[Any]) -> bytes:
    return cv2.imencode('.tiff', pixels)[1].tobytes()


def zstd_image(pixels: NDArray[Any], encoding: str, pack: Callable[[bytes], bytes]) -> bytes:
    """Return the data of zstd_image_transport, which up to Jazzy packs with gzip."""
    step, name = pixels.nbytes // len(pixels), encoding.encode()
    head = struct.pack('<IIBII', *pixels.shape[:2], 0, step, len(name))
    return head + name + pack(pixels.tobytes())


def rvl(pixels: NDArray[Any]) -> bytes:
    """Return the RVL image of pixels without zeros."""
    groups: list[int] = []

    def put(number: int) -> None:
        while number > 7:
            groups.append(8 | number & 7)
            number >>= 3
        groups.append(number)

    flat = pixels.ravel().astype(int)
    steps = np.diff(flat, prepend=0)
    for number in (0, len(flat), *np.where(steps >= 0, 2 * steps, -2 * steps - 1).tolist()):
        put(number)
    groups += [0] * (-len(groups) % 8)
    words = [
        int(''.join(f'{g:x}' for g in groups[n : n + 8]), 16) for n in range(0, len(groups), 8)
    ]
    return struct.pack(f'<II{len(words)}I', *pixels.shape[::-1], *words)


def static_frames(_: int) -> Message:
    return static_transforms((bag_messages.CAMERA_FRAME, OWN_FRAME, T_COLOR_DEPTH))


def extrinsics(_: int) -> Message:
    """Return the place of the depth camera as realsense2_camera publishes it."""
    R, t = T_COLOR_DEPTH[:3, :3], T_COLOR_DEPTH[:3, 3].copy()
    return new_message(EXTRINSICS, rotation=R.T.ravel(), translation=t)


def rgbd(stamp_ns: int) -> Message:
    """Return the message RGBD of realsense2_camera."""
    color = COLORS.message(stamp_ns)
    camera = INFO.message(stamp_ns)
    return new_message(
        RGBD, header=color.header, rgb_camera_info=camera, depth_camera_info=camera, rgb=color,
        depth=DEPTHS.message(stamp_ns),
    )  # fmt: skip


def gray(encoding: str) -> Topic:
    """Return color images of a gray encoding, of value 120."""
    if encoding.startswith('mono16'):
        return raw(C, np.full((48, 64), 120 << 8, np.uint16), encoding)
    rows = {'nv12': 72, 'nv21': 72, 'i420': 72, 'nv24': 144}.get(encoding, 48)
    pixels = np.full((rows, 64), 128, np.uint8)
    pixels[:48] = 16 + 120 * 219 // 255 if rows > 48 else 120
    return raw(C, pixels, encoding, rows=48)


OWN_DEPTHS = raw(D, OWN_MM, '16UC1', frame=OWN_FRAME)
OWN_INFO = info('/camera/depth/camera_info', OWN)
TF = Topic('/tf_static', TF_MESSAGE, static_frames)
PLACE = Topic('/camera/extrinsics/depth_to_color', EXTRINSICS, extrinsics)
HALF_MM = DEPTH_MM[::2, ::2].copy()
HALF_M = np.kron(HALF_MM / 1000, np.ones((2, 2))).astype(np.float32)
PNG_DEPTH = images.compressed_depth_of_png(png(DEPTH_MM))
RGB = COLOR[..., ::-1].copy()
BGRA = np.dstack([COLOR, np.full((48, 64), 255, np.uint8)])
DEPTHS_BY_ENCODING: dict[str, NDArray[Any]] = {
    '16UC1': DEPTH_MM, 'mono16': DEPTH_MM, '16SC1': DEPTH_MM.astype(np.int16), '32FC1': DEPTH_M,
    '64FC1': DEPTH_MM / 1000,
}  # fmt: skip
SIZES = 'sizes'
VARIANTS = [
    Variant('recorders', 'MCAP of rosbag2', bag(COLORS, DEPTHS, INFO)),
    *(
        Variant('recorders', f'ROS 1 `.bag`, {how or "not"} compressed', ros1(
            bag(COLORS, DEPTHS, INFO), how))
        for how in ('', 'bz2', 'lz4')
    ),
    Variant('recorders', '`realsense2_camera_msgs/RGBD` alone', bag(
        Topic('/camera/rgbd', RGBD, rgbd))),
    *(
        Variant('color', f'`{encoding}`', bag(raw(C, pixels, encoding), DEPTHS, INFO))
        for encoding, pixels in {
            'bgr8': COLOR, 'rgb8': RGB, 'bgra8': BGRA, '8UC3': COLOR,
            'bgr16': COLOR.astype(np.uint16) << 8,
        }.items()
    ),
    *(
        Variant('color', f'`{encoding}`', bag(gray(encoding), DEPTHS, INFO))
        for encoding in (
            'mono8', 'mono16', 'nv12', 'nv21', 'nv24', 'i420', 'bayer_rggb8', 'bayer_gbrg8',
        )
    ),
    Variant('color', '`thermal8`', bag(raw(C, COLOR[..., 0].copy(), 'thermal8'), DEPTHS, INFO),
            'color image has encoding "thermal8"; use one of bgr8'),
    Variant('color', 'compressed, PNG', bag(
        packed(f'{C}/compressed', png(COLOR), images.PNG_FORMAT), DEPTHS, INFO)),
    Variant('color', 'compressed, TIFF', bag(
        packed(f'{C}/compressed', tiff(COLOR), 'bgr8; tiff compressed bgr8'), DEPTHS, INFO)),
    Variant('color', '`zstd_image_transport`', bag(
        packed(f'{C}/zstd', zstd_image(COLOR, 'bgr8', zstd.compress), 'zstd'), DEPTHS, INFO)),
    Variant('color', 'compressed, JPEG XL', bag(
        packed(f'{C}/compressed', b'\xff\x0a' + bytes(99), 'bgr8; jxl'), DEPTHS, INFO),
            'compressed color image of format "bgr8; jxl" of 101 bytes is not a readable JPEG'),
    *(
        Variant('depth', f'`{encoding}`', bag(COLORS, raw(D, pixels, encoding), INFO))
        for encoding, pixels in DEPTHS_BY_ENCODING.items()
    ),
    *(
        Variant('depth', what, bag(COLORS, packed(f'{D}/{suffix}', data, format_), INFO))
        for what, suffix, data, format_ in (
            ('compressedDepth, PNG', 'compressedDepth', PNG_DEPTH, '16UC1; compressedDepth png'),
            ('compressedDepth of older plugins', 'compressedDepth', PNG_DEPTH,
             '16UC1; compressedDepth'),
            ('compressedDepth, RVL', 'compressedDepth', bytes(12) + rvl(DEPTH_MM),
             '16UC1; compressedDepth rvl'),
            ('compressed, PNG', 'compressed', png(DEPTH_MM), '16UC1; png compressed '),
            ('compressed, TIFF of floats', 'compressed', tiff(DEPTH_M), '32FC1; tiff compressed '),
            ('`zstd_image_transport` of Jazzy', 'zstd',
             zstd_image(DEPTH_MM, '16UC1', gzip.compress), 'zstd'),
            ('`zstd_image_transport` with zstd', 'zstd',
             zstd_image(DEPTH_M, '32FC1', zstd.compress), 'zstd'),
        )
    ),
    Variant('depth', 'no images', bag(COLORS, INFO), 'has no depth images'),
    Variant(SIZES, 'depth of half the size, in the frame of color', bag(
        COLORS, raw(D, HALF_MM, '16UC1'), INFO), depth_m=HALF_M),
    Variant(SIZES, 'depth of another size, in the frame of color', bag(
        COLORS, raw(D, OWN_MM, '16UC1'), INFO),
            'depth is not registered to color: it is 40x30, color 64x48'),
    Variant(SIZES, 'depth in its own frame, `camera_info` and `/tf_static`', bag(
        COLORS, OWN_DEPTHS, INFO, OWN_INFO, TF), depth_m=MAPPED_M),
    Variant(SIZES, 'depth in its own frame, `camera_info` and `extrinsics/depth_to_color`', bag(
        COLORS, OWN_DEPTHS, INFO, OWN_INFO, PLACE), depth_m=MAPPED_M),
    Variant(SIZES, 'depth in its own frame, no transform', bag(
        COLORS, OWN_DEPTHS, INFO, OWN_INFO), 'depth is not registered to color: it is 40x30'),
    Variant(SIZES, 'depth of half the size in its own frame, no transform', bag(
        COLORS, raw(D, HALF_MM, '16UC1', frame=OWN_FRAME), INFO),
            'depth is not registered to color: its frame is camera_depth_optical_frame'),
    *(
        Variant(SIZES, f'`camera_info` of {what}', bag(
            COLORS, DEPTHS, info(CAMERA_OF_C, CAMERA.scaled_to(size) or CAMERA)))
        for what, size in {'twice the size': (128, 96), 'half the size': (32, 24)}.items()
    ),
    Variant(SIZES, '`camera_info` of 100x48 px', bag(
        COLORS, DEPTHS, info(CAMERA_OF_C, CameraModel(100, 48, 60.0, 60.0, 49.5, 23.5))),
            'image is 64x48, the camera 100x48'),
    Variant(SIZES, 'no `camera_info`', bag(COLORS, DEPTHS),
            'has no camera_info of the color images'),
]  # fmt: skip
