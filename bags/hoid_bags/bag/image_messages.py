"""Decoding of serialized image messages of bags, raw or compressed, to arrays."""

from __future__ import annotations

import re
from typing import NamedTuple

from hoid_bags.bag.contents import BagTopic
from hoid_bags.images import check_complete
from hoid_bags.storage.bag_types import IMAGE, deserialize
from hoid_common.io import images
from hoid_common.io.compression.compressed_images import (
    compressed_head,
    decode_compressed_color,
    decode_compressed_depth,
)
from hoid_common.values import ByteArray, Float32Array

_DEPTH_NAME = re.compile('depth|stereo|disparity', re.IGNORECASE)


def decode_color(data: bytes, topic: BagTopic) -> ByteArray:
    """Return the (H, W, 3) uint8 BGR image of a color message.

    MessageError: it is no image message, has an unsupported encoding, or cannot be decoded.
    InputError: the compressed data is empty, or a truncated JPEG or PNG.
    """
    message = deserialize(data, topic.type_name)
    if topic.type_name == IMAGE:
        return images.decode_color(message)
    check_complete(message.data.tobytes(), topic.name)
    return decode_compressed_color(message.data, message.format)


def decode_depth(data: bytes, topic: BagTopic, units_per_m: float = 0.0) -> Float32Array:
    """Return the (H, W) float32 depth in m of a depth message, with 0 for "no reading".

    If `units_per_m` is 0, integer depth is in mm and float depth in m. MessageError as in
    `decode_color`, or if the median depth shows a wrong unit.
    """
    message = deserialize(data, topic.type_name)
    if topic.type_name == IMAGE:
        return images.decode_depth(message, units_per_m)
    return decode_compressed_depth(message.format, message.data, units_per_m)


class ImageHead(NamedTuple):
    """Kind and size of an image message."""

    is_depth: bool
    size_px: tuple[int, int] | None  # width, height; None: not known without decoding


def image_head(data: bytes, topic: BagTopic) -> ImageHead:
    """Return kind and size of an image from its message, without decoding the image.

    A mono16 image is depth only if the topic's name contains depth, stereo or disparity.
    MessageError: the data is no message of this type.
    """
    message = deserialize(data, topic.type_name)
    encoding: str
    size_px: tuple[int, int] | None
    if topic.type_name == IMAGE:
        encoding, size_px = message.encoding, (message.width, message.height)
    else:
        encoding, size_px = compressed_head(message.format, message.data)
    is_gray = encoding == 'mono16' and not _DEPTH_NAME.search(topic.name)
    return ImageHead(encoding in images.DEPTH_ENCODINGS and not is_gray, size_px)
