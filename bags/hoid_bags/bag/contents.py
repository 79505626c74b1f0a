"""The topics and messages of a bag.

Images inside other messages, in video and in realsense2_camera's RGBD, are topics of their own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import NamedTuple

from rosbags.interfaces import Qos

from hoid_bags.bag import bag_messages
from hoid_bags.storage import bag_types as types
from hoid_bags.storage.video import VIDEO_TYPES, DecodedImage, VideoDecoder, video_packet
from hoid_common.errors import MessageError

_OF_RGBD = {
    'rgb': ('rgb/image_raw', types.IMAGE),
    'depth': ('depth/image_raw', types.IMAGE),
    'rgb_camera_info': ('rgb/camera_info', types.CAMERA_INFO),
    'depth_camera_info': ('depth/camera_info', types.CAMERA_INFO),
}
_OF_VIDEO = 'image_raw'


class BagTopic(NamedTuple):
    """One topic of a bag."""

    name: str  # absolute name
    type_name: str
    num_messages: int
    qos: Qos | None  # profile that its first publisher offered; None: unknown
    is_readable: bool = True  # False: ROS 2 lacks the type of a topic of a ROS 1 bag
    source: str = ''  # topic whose messages contain this one, as a video contains images
    is_video: bool = False  # whether `source` is a video
    video_px: tuple[int, int] | None = None  # width and height of its images; None: unknown


class BagMessage(NamedTuple):
    """One message, still serialized."""

    topic: str
    log_ns: int  # time (ns) at which it was recorded
    data: bytes  # serialized message (CDR)


def is_container(topic: BagTopic) -> bool:
    """Return whether the messages of a topic may contain messages of other topics."""
    return topic.is_readable and topic.type_name in (
        types.RGBD,
        types.COMPRESSED_IMAGE,
        *VIDEO_TYPES,
    )


def parts_of(topic: BagTopic, first: bytes) -> tuple[BagTopic, ...]:
    """Return the topics inside a container topic, given its first message, or MessageError."""
    part = topic._replace(source=topic.name)
    if topic.type_name == types.RGBD:
        return tuple(
            part._replace(name=f'{topic.name}/{name}', type_name=kind)
            for name, kind in _OF_RGBD.values()
        )
    packet = video_packet(first, topic.type_name)
    if not packet.codec:
        return ()
    name = f'{topic.name}/{_OF_VIDEO}'
    return (
        part._replace(name=name, type_name=types.IMAGE, is_video=True, video_px=packet.size_px),
    )


class PartReader:
    """Extracts the messages of the wanted topics from the messages that contain them."""

    def __init__(self, topic: BagTopic, wanted: Collection[str]) -> None:
        self._topic, self._type_name, self._wanted = topic.name, topic.type_name, wanted
        self._decoder: VideoDecoder | None = None

    def read(self, log_ns: int, data: bytes) -> Iterator[BagMessage]:
        """Yield the messages that a message contains; nothing if the message is damaged.

        InputError: the message is video, and PyAV is missing or has no decoder.
        """
        with suppress(MessageError):
            yield from (
                self._rgbd(log_ns, data)
                if self._type_name == types.RGBD
                else self._images(log_ns, data)
            )

    def _rgbd(self, log_ns: int, data: bytes) -> Iterator[BagMessage]:
        message = types.deserialize(data, types.RGBD)
        for field, (name, kind) in _OF_RGBD.items():
            if f'{self._topic}/{name}' in self._wanted:
                part = bytes(types.serialize(getattr(message, field), kind))
                yield BagMessage(f'{self._topic}/{name}', log_ns, part)

    def _images(self, log_ns: int, data: bytes) -> Iterator[BagMessage]:
        packet = video_packet(data, self._type_name)
        if self._decoder is None:
            self._decoder = VideoDecoder(self._topic, packet.codec)
        yield from map(self._message, self._decoder.decode(packet, log_ns))

    def flush(self) -> Iterator[BagMessage]:
        if self._decoder is not None:
            yield from map(self._message, self._decoder.flush())

    def _message(self, image: DecodedImage) -> BagMessage:
        packet, log_ns, image_bgr = image
        message = bag_messages.image(packet.stamp_ns, image_bgr, 'bgr8')
        message.header.frame_id = packet.frame_id
        name = f'{self._topic}/{_OF_VIDEO}'
        return BagMessage(name, log_ns, bytes(types.serialize(message, types.IMAGE)))
