"""Decoding of video in the messages of a topic, by PyAV, which is an optional extra."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoid_bags.storage import bag_types as types
from hoid_common.errors import InputError, replaced_by
from hoid_common.io.untrusted import open_regular
from hoid_common.messages import stamp_from_msg
from hoid_common.values import ByteArray

VIDEO_TYPES = (types.FFMPEG_PACKET, types.COMPRESSED_VIDEO)
"""Message types that always carry video; CompressedImage carries it if `format` names a codec."""
# FFmpeg's decoder by a part of the names that encoders and messages use.
_CODECS = {'264': 'h264', 'avc': 'h264', '265': 'hevc', 'hevc': 'hevc', 'av1': 'av1', 'vp9': 'vp9'}
_MAX_DELAY = 64  # chosen: packets that a decoder holds; H.264 and H.265 allow 16
_INSTALL = './hoid env python -m pip install -r requirements/video.lock'


class Packet(NamedTuple):
    """One message of a video."""

    stamp_ns: int
    frame_id: str
    codec: str  # FFmpeg's name; '' = no video
    size_px: tuple[int, int] | None  # None: unknown before decoding
    data: bytes


def video_packet(data: bytes, type_name: str) -> Packet:
    """Return the packet in a message, with codec '' if it is no video, or raise MessageError."""
    message = types.deserialize(data, type_name)
    if type_name == types.COMPRESSED_VIDEO:
        stamp, frame, name, size = message.timestamp, message.frame_id, message.format, None
    else:
        stamp, frame = message.header.stamp, message.header.frame_id
        is_ffmpeg = type_name == types.FFMPEG_PACKET
        name = message.encoding.partition(';')[0] if is_ffmpeg else message.format
        size = (message.width, message.height) if is_ffmpeg else None
    known = [codec for part, codec in _CODECS.items() if part in name.lower()]
    is_image = type_name == types.COMPRESSED_IMAGE and not known
    codec = '' if is_image else known[0] if known else name
    return Packet(stamp_from_msg(stamp), frame, codec, size, message.data.tobytes())


DecodedImage = tuple[Packet, int, ByteArray]
"""The packet of an image, its log time (ns), and the (H, W, 3) uint8 BGR image."""


class VideoDecoder:
    """Decodes the packets of one topic in the order of the recording.

    Packets before the first key frame, and damaged ones, give no image. InputError: PyAV is not
    installed, or has no such decoder.
    """

    def __init__(self, topic: str, codec: str) -> None:
        av = _import_av(f'{topic}: is {codec} video')
        self._packet, self._errors = av.Packet, av.FFmpegError
        missing = InputError(f'{topic}: PyAV has no decoder for {codec} video')
        with replaced_by(missing, av.FFmpegError, ValueError):
            self._codec: Any = av.CodecContext.create(codec, 'r')
        self._codec.thread_count = 1
        self._fed: dict[int, tuple[Packet, int]] = {}  # by pts: packet and log time
        self._next_pts = 0
        self._waits_for_key = True

    def decode(self, packet: Packet, log_ns: int) -> Iterator[DecodedImage]:
        """Yield the images that a packet completes, usually its own."""
        av_packet = self._packet(packet.data)
        av_packet.pts = av_packet.dts = self._next_pts
        self._fed[self._next_pts] = packet, log_ns
        self._next_pts += 1
        yield from self._decoded(av_packet)

    def flush(self) -> Iterator[DecodedImage]:
        """Yield the images that the decoder still holds at the end of the recording."""
        yield from self._decoded(None)

    def _decoded(self, av_packet: Any) -> Iterator[DecodedImage]:
        try:
            frames = self._codec.decode(av_packet)
        except self._errors:  # damaged, or before the first key frame
            self._waits_for_key = True
            return
        for frame in frames:
            packet, log_ns = self._fed.pop(frame.pts)
            # Decoders conceal damage with earlier image content, until the next key frame.
            self._waits_for_key = (self._waits_for_key or frame.is_corrupt) and not frame.key_frame
            if not self._waits_for_key:
                image_bgr = np.ascontiguousarray(frame.to_ndarray(format='bgr24'))
                yield packet, log_ns, image_bgr
        for pts in [pts for pts in self._fed if pts < self._next_pts - _MAX_DELAY]:
            del self._fed[pts]  # the decoder returned no image for it


class VideoFile:
    """A video file whose images are read in their order. Raises InputError if it is no video."""

    def __init__(self, path: Path) -> None:
        self._av = _import_av(f'{path}: is video')
        self.path = path
        self._next = 0
        self._open()
        codec = self._stream.codec_context
        self.size_px: tuple[int, int] = codec.width, codec.height
        self.num_images: int = self._stream.frames  # 0: unknown

    def image(self, number: int) -> ByteArray:
        """Return the (H, W, 3) uint8 BGR image with index `number`; going backward is slow."""
        if number < self._next:
            self._open()
        try:
            for i, frame in enumerate(self._frames, self._next):
                self._next = i + 1
                if i == number:
                    return np.ascontiguousarray(frame.to_ndarray(format='bgr24'))
        except self._av.FFmpegError as error:
            raise InputError(f'{self.path}: damaged at image {self._next}') from error
        raise InputError(f'{self.path}: has {self._next} images, not {number + 1}')

    def _open(self) -> None:
        open_regular(self.path).close()
        with replaced_by(InputError(f'{self.path}: no video'), self._av.FFmpegError, IndexError):
            self._container: Any = self._av.open(str(self.path))
            self._stream: Any = self._container.streams.video[0]
            self._frames: Iterator[Any] = self._container.decode(video=0)
        self._next = 0


def _import_av(what: str) -> Any:
    """Return the PyAV module; InputError, which names the install command, if it is missing."""
    if find_spec('av') is None:
        raise InputError(f'{what}, which needs the extra "video": {_INSTALL}')
    return import_module('av')
