"""Serialized image messages of bags, raw or compressed, decoded to arrays."""

from __future__ import annotations

from hoid_bags.bag.bag_reader import BagTopic
from hoid_bags.bag.bag_types import IMAGE, deserialize
from hoid_bags.images import check_complete
from hoid_common.io import images
from hoid_common.values import ByteArray, Float32Array


def decode_color(data: bytes, topic: BagTopic) -> ByteArray:
    """Return the (H, W, 3) uint8 BGR image of a color message.

    Raises:
        MessageError: It is no image message, or has another encoding.
        InputError: It contains a truncated JPEG or PNG.
    """
    message = deserialize(data, topic.type_name)
    if topic.type_name == IMAGE:
        return images.decode_color(message)
    check_complete(message.data.tobytes(), topic.name)
    return images.decode_compressed_color(message.data)


def decode_depth(data: bytes, topic: BagTopic) -> Float32Array:
    """Return the (H, W) float32 depth in m of a depth message; MessageError if it is none."""
    message = deserialize(data, topic.type_name)
    if topic.type_name == IMAGE:
        return images.decode_depth(message)
    return images.decode_compressed_depth(message.format, message.data)


def is_depth(data: bytes, topic: BagTopic) -> bool:
    """Return whether an image message has an encoding of depth; MessageError if it is none."""
    message = deserialize(data, topic.type_name)
    if topic.type_name == IMAGE:
        return message.encoding in images.DEPTH_ENCODINGS
    return 'compressedDepth' in message.format
