"""Conversion of a TUM folder to an MCAP bag that `ros2 bag play` accepts."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.encoding import (
    JPEG,
    PNG,
    RAW,
    ColorEncoder,
    DepthEncoder,
    choose_depth_encoder,
)
from hoid_bags.progress import progress
from hoid_bags.storage.bag_types import CAMERA_INFO, IMU, POSE_STAMPED, Message
from hoid_bags.tum.listing import ListedImage
from hoid_bags.tum.tum_folder import TumFolder, open_tum_folder
from hoid_common import topics
from hoid_common.config import Config, param
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import CameraModel


@dataclass(frozen=True)
class ConvertConfig(Config):
    """Options of a conversion.

    Raw images are the default, because nodes then need no time for decoding. Compressed chunks
    make a bag 1.4 to 2.9 times smaller, but reading a frame takes 3.8 ms instead of 0.3 ms
    (decision 024).
    """

    rgb: str = param(
        RAW,
        'Encoding of color images. Choose jpeg for small bags, png for smaller bags without loss.',
        choices=(RAW, PNG, JPEG),
    )
    depth: str = param(
        RAW,
        'Encoding of depth images. Choose png for smaller bags without loss.',
        choices=(RAW, PNG),
    )
    jpeg_quality: int = param(
        95,
        'Quality of the JPEG images that are made from files of another format, from 1 to 100.',
        minimum=1,
        maximum=100,
    )
    depth_units_per_m: float = param(
        0.0,
        'Depth units per meter in the image files (1/m); 0 means those of the layout, such as '
        '5000 for TUM RGB-D.',
        minimum=0.0,
    )
    round_depth: bool = param(
        False,
        'Whether to round depth to whole millimeters. Set it to true to encode depth with a finer '
        'resolution as png, which is refused otherwise (decision 023).',
    )
    compress: bool = param(
        False,
        'Whether to compress the chunks of the bag with zstd. Set it to true for smaller bags, '
        'which take longer to read.',
    )


class _Stamped(NamedTuple):
    stamp_ns: int
    topic: str
    message: Message


def convert(
    folder: Path,
    bag: Path,
    config: ConvertConfig | None = None,
    camera: CameraModel | None = None,
    *,
    show_progress: bool = False,
) -> None:
    """Convert a folder of images to a bag, image by image.

    Args:
        folder: The recording.
        bag: Folder of the bag, which is created.
        config: Options of the conversion; None: the defaults.
        camera: Camera of the recording; None: the published camera whose name the folder's name
            contains.
        show_progress: Whether to draw a progress bar on stderr.

    Raises:
        InputError: The recording or one of its files cannot be used, or the bag exists already or
            cannot be written. No part of the new bag remains.
        MessageError: An image cannot be encoded.
        ConfigError: A list of the recording contains a file name that no file can have.
    """
    config = config or ConvertConfig()
    source = open_tum_folder(folder, camera, config.depth_units_per_m or None)
    if str(source) and show_progress:
        sys.stderr.write(f'{folder}: {source}\n')
    color = ColorEncoder(source.camera, config.rgb, config.jpeg_quality)
    with BagWriter(bag, compress=config.compress) as writer:
        depth = choose_depth_encoder(
            source.depth,
            source.camera,
            config.depth,
            source.depth_units_per_m,
            round_to_mm=config.round_depth,
        )
        _add_topics(writer, source, color, depth)
        items = _in_order_of_time(source, color, depth)
        for item in progress(items, _num_messages(source), 'messages', show=show_progress):
            writer.write(item.topic, item.stamp_ns, item.message)


def _add_topics(
    writer: BagWriter, source: TumFolder, color: ColorEncoder, depth: DepthEncoder
) -> None:
    writer.add_topic(topics.CAMERA_INFO, CAMERA_INFO)
    writer.add_topic(color.topic, color.type_name)
    writer.add_topic(depth.topic, depth.type_name)
    if source.ground_truth is not None:
        writer.add_topic(topics.GROUND_TRUTH, POSE_STAMPED)
    for topic, _ in _imu_tables(source):
        writer.add_topic(topic, IMU)


def _num_messages(source: TumFolder) -> int:
    truth = source.ground_truth
    num_images = 2 * len(source.color) + len(source.depth)  # each color image has a camera_info
    num_samples = sum(len(table.stamps_ns) for _, table in _imu_tables(source))
    return num_images + (0 if truth is None else len(truth)) + num_samples


def _imu_tables(source: TumFolder) -> list[tuple[str, NumberTable]]:
    """Return the samples of the sensors that the recording has, each with its topic."""
    gyro, accelerometer = source.imu
    tables = ((topics.ACCELEROMETER, accelerometer), (topics.IMU, gyro))
    return [(topic, table) for topic, table in tables if table is not None]


def _in_order_of_time(
    source: TumFolder, color: ColorEncoder, depth: DepthEncoder
) -> Iterator[_Stamped]:
    # Messages with equal stamps keep this order: the camera comes before its image.
    streams = (
        _camera_stream(source),
        _image_stream(source.color, color),
        _image_stream(source.depth, depth),
        _truth_stream(source),
        *(_imu_stream(topic, table) for topic, table in _imu_tables(source)),
    )
    return heapq.merge(*streams, key=attrgetter('stamp_ns'))


def _camera_stream(source: TumFolder) -> Iterator[_Stamped]:
    for image in source.color:
        message = bag_messages.camera_info(image.stamp_ns, source.camera)
        yield _Stamped(image.stamp_ns, topics.CAMERA_INFO, message)


def _image_stream(
    images: Iterable[ListedImage], encoder: ColorEncoder | DepthEncoder
) -> Iterator[_Stamped]:
    for image in images:
        yield _Stamped(image.stamp_ns, encoder.topic, encoder.message(image))


def _truth_stream(source: TumFolder) -> Iterator[_Stamped]:
    truth = source.ground_truth
    if truth is not None:
        for stamp_ns, pose in zip(truth.stamps_ns.tolist(), truth.T_world_camera, strict=True):
            message = bag_messages.pose_stamped(stamp_ns, pose)
            yield _Stamped(stamp_ns, topics.GROUND_TRUTH, message)


def _imu_stream(topic: str, table: NumberTable) -> Iterator[_Stamped]:
    for stamp_ns, values in zip(table.stamps_ns.tolist(), table.values, strict=True):
        is_gyro = topic == topics.IMU
        sensors = (None, values) if is_gyro else (values, None)
        yield _Stamped(stamp_ns, topic, bag_messages.imu(stamp_ns, *sensors))
