"""Images inside other messages, as topics of their own: video, and realsense2_camera's RGBD."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import NamedTuple

from hoid_bags.bag import bag_messages
from hoid_bags.storage.bag_types import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    RGBD,
    deserialize,
    serialize,
)
from hoid_bags.storage.video import VIDEO_TYPES, DecodedImage, VideoDecoder, video_packet
from hoid_common.errors import MessageError

_OF_RGBD = {
    'rgb': ('rgb/image_raw', IMAGE),
    'depth': ('depth/image_raw', IMAGE),
    'rgb_camera_info': ('rgb/camera_info', CAMERA_INFO),
    'depth_camera_info': ('depth/camera_info', CAMERA_INFO),
}
_OF_VIDEO = 'image_raw'


class Part(NamedTuple):
    """A topic that the messages of another topic contain."""

    name: str
    type_name: str
    is_video: bool = False
    size_px: tuple[int, int] | None = None  # of the images of a video; None: unknown


class PartMessage(NamedTuple):
    """A message of a part, as `BagMessage`."""

    topic: str
    log_ns: int
    data: bytes


def is_container(type_name: str) -> bool:
    """Return whether messages of a type may contain messages of other topics."""
    return type_name in (RGBD, COMPRESSED_IMAGE, *VIDEO_TYPES)


def parts_of(topic: str, type_name: str, first: bytes) -> tuple[Part, ...]:
    """Return the topics that the messages of a topic contain.

    Raises:
        MessageError: The data is no message of this type.
    """
    if type_name == RGBD:
        return tuple(Part(f'{topic}/{name}', kind) for name, kind in _OF_RGBD.values())
    packet = video_packet(first, type_name)
    return (Part(f'{topic}/{_OF_VIDEO}', IMAGE, True, packet.size_px),) if packet.codec else ()


class PartReader:
    """Takes the wanted parts from the messages of one topic."""

    def __init__(self, topic: str, type_name: str, wanted: Collection[str]) -> None:
        self._topic, self._type_name, self._wanted = topic, type_name, wanted
        self._decoder: VideoDecoder | None = None

    def read(self, log_ns: int, data: bytes) -> Iterator[PartMessage]:
        """Yield the parts of a message; a damaged message has none.

        Raises:
            InputError: It is video, and PyAV is missing or has no decoder.
        """
        with suppress(MessageError):
            yield from (
                self._rgbd(log_ns, data) if self._type_name == RGBD else self._images(log_ns, data)
            )

    def _rgbd(self, log_ns: int, data: bytes) -> Iterator[PartMessage]:
        message = deserialize(data, RGBD)
        for field, (name, kind) in _OF_RGBD.items():
            if f'{self._topic}/{name}' in self._wanted:
                part = bytes(serialize(getattr(message, field), kind))
                yield PartMessage(f'{self._topic}/{name}', log_ns, part)

    def _images(self, log_ns: int, data: bytes) -> Iterator[PartMessage]:
        packet = video_packet(data, self._type_name)
        if self._decoder is None:
            self._decoder = VideoDecoder(self._topic, packet.codec)
        for image in self._decoder.decode(packet, log_ns):
            yield self._message(image)

    def flush(self) -> Iterator[PartMessage]:
        """Yield what is left at the end of the recording."""
        if self._decoder is not None:
            for image in self._decoder.flush():
                yield self._message(image)

    def _message(self, image: DecodedImage) -> PartMessage:
        message = bag_messages.image(image.stamp_ns, image.image_bgr, 'bgr8')
        message.header.frame_id = image.frame_id
        name = f'{self._topic}/{_OF_VIDEO}'
        return PartMessage(name, image.log_ns, bytes(serialize(message, IMAGE)))
