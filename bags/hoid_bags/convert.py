"""Conversion of a recording in files to an MCAP bag that `ros2 bag play` accepts."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from operator import itemgetter
from pathlib import Path

from hoid_bags.bag import bag_messages, encoding
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.encoding import JPEG, PNG, RAW
from hoid_bags.progress import progress
from hoid_bags.storage.bag_types import CAMERA_INFO, IMU, POSE_STAMPED, Message
from hoid_bags.tum.listing import Images
from hoid_bags.tum.tum_folder import TumFolder, open_tum_folder
from hoid_common import topics
from hoid_common.config import Config, param
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import CameraModel, Trajectory


@dataclass(frozen=True)
class ConvertConfig(Config):
    """Options of a conversion.

    Raw images are the default, because nodes then need no time for decoding (decision 024).
    """

    rgb: str = param(RAW, 'encoding of color images', choices=(JPEG, PNG, RAW))
    depth: str = param(RAW, 'encoding of depth images', choices=(PNG, RAW))
    round_depth: bool = param(False, 'round depth to mm, which PNG images may require')
    compress: bool = param(False, 'compress the bag with zstd: smaller, but slower to play')
    jpeg_quality: int = param(95, limits=(1, 100), internal=True)
    depth_units_per_m: float = param(
        0.0, limits=(0.0, inf), internal=True
    )  # 0: units of the layout


_Stream = Iterator[tuple[int, str, Message]]  # stamp (ns), topic, message; in order of time


def convert(
    folder: Path,
    bag: Path,
    config: ConvertConfig | None = None,
    camera: CameraModel | None = None,
    *,
    show_progress: bool = False,
) -> None:
    """Convert a recording in files to a bag, image by image. `camera` None: the recording's own.

    InputError if the recording or one of its files cannot be used, or the bag exists already or
    cannot be written. No part of the new bag remains. MessageError if an image cannot be encoded.
    ConfigError if a list of the recording contains a file name that no file can have.
    """
    config = config or ConvertConfig()
    source = open_tum_folder(folder, camera, config.depth_units_per_m or None)
    if str(source) and show_progress:
        sys.stderr.write(f'{folder}: {source}\n')
    camera, units_per_m = source.camera, source.depth_units_per_m
    color = encoding.color_encoding(camera, config.rgb, config.jpeg_quality)
    with BagWriter(bag, compress=config.compress) as writer:
        depth = encoding.depth_encoding(
            source.depth, camera, config.depth, units_per_m, round_to_mm=config.round_depth
        )
        # Messages with equal stamps keep this order: the camera comes before its image.
        streams = [
            (topics.CAMERA_INFO, CAMERA_INFO, len(source.color), _cameras(source)),
            (color.topic, color.type_name, len(source.color), _images(source.color, color)),
            (depth.topic, depth.type_name, len(source.depth), _images(source.depth, depth)),
            *_poses(source.ground_truth),
            *_samples(*source.layout.imu(source.path)),
        ]
        for topic, type_name, _, _ in streams:
            writer.add_topic(topic, type_name)
        messages = heapq.merge(*(stream for *_, stream in streams), key=itemgetter(0))
        total = sum(number for _, _, number, _ in streams)
        for stamp_ns, topic, message in progress(messages, total, 'messages', show=show_progress):
            writer.write(topic, stamp_ns, message)


def _cameras(source: TumFolder) -> _Stream:
    for image in source.color:
        message = bag_messages.camera_info(image.stamp_ns, source.camera)
        yield image.stamp_ns, topics.CAMERA_INFO, message


def _images(images: Images, stored: encoding.Encoding) -> _Stream:
    for image in images:
        yield image.stamp_ns, stored.topic, stored.message(image)


def _poses(truth: Trajectory | None) -> Iterator[tuple[str, str, int, _Stream]]:
    if truth is not None:
        rows = zip(truth.stamps_ns.tolist(), truth.T_world_camera, strict=True)
        stream = ((ns, topics.GROUND_TRUTH, bag_messages.pose_stamped(ns, T)) for ns, T in rows)
        yield topics.GROUND_TRUTH, POSE_STAMPED, len(truth), stream


def _samples(
    gyro: NumberTable | None, accelerometer: NumberTable | None
) -> Iterator[tuple[str, str, int, _Stream]]:
    """Yield topic, type, number of messages and stream of each IMU sensor in the recording."""
    for topic, table in ((topics.ACCELEROMETER, accelerometer), (topics.IMU, gyro)):
        if table is not None:
            yield topic, IMU, len(table.stamps_ns), _sensor(topic, table)


def _sensor(topic: str, table: NumberTable) -> _Stream:
    for stamp_ns, values in zip(table.stamps_ns.tolist(), table.values, strict=True):
        sensors = (None, values) if topic == topics.IMU else (values, None)
        yield stamp_ns, topic, bag_messages.imu(stamp_ns, *sensors)
