"""Images inside other messages: video of three kinds, and RGBD of realsense2_camera."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import describe, summarize
from hoid_bags.bag.repair import copy_bag
from hoid_bags.sequence import open_sequence
from hoid_bags.storage.bag_types import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    IMAGE,
    RGBD,
    Message,
    new_message,
)
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

av = pytest.importorskip('av', reason='an optional extra: requirements/video.lock')

CAMERA = CameraModel(160, 128, 150, 150, 79.5, 63.5)
NUM, PERIOD_NS = 25, 33_000_000
_STEP = 8  # difference of the brightness of two images
_LOSS = 5  # of the codecs and their colors


def picture(i: int) -> NDArray[np.uint8]:
    """Return a smooth image that names its number by its brightness."""
    row = np.linspace(0, 60, 160) + _STEP * i
    return np.repeat(np.tile(row, (128, 1))[..., None], 3, axis=2).astype(np.uint8)


def stamp_ns(i: int) -> int:
    return 10**9 + i * PERIOD_NS


def packets(codec: str, num_b_frames: int = 0) -> list[bytes]:
    """Return the packets of NUM pictures in the order of decoding, one for each."""
    encoder: Any = av.CodecContext.create(codec, 'w')
    encoder.width, encoder.height, encoder.pix_fmt = 160, 128, 'yuv420p'
    encoder.time_base = Fraction(1, 30)
    encoder.options = {'crf': '1', 'bf': str(num_b_frames), 'g': '10', 'preset': 'ultrafast'}
    if codec == 'libx265':
        encoder.options = {
            'preset': 'ultrafast',
            'x265-params': 'bframes=0:keyint=10:crf=1:log-level=0',
        }
    found: list[bytes] = []
    for i in range(NUM):
        frame = av.VideoFrame.from_ndarray(picture(i), format='bgr24')
        frame.pts = i
        found += [bytes(packet) for packet in encoder.encode(frame)]
    found += [bytes(packet) for packet in encoder.encode(None)]
    assert len(found) == NUM
    return found


def ffmpeg(i: int, data: bytes, codec: str) -> Message:
    """Return the message of ffmpeg_image_transport."""
    return new_message(
        FFMPEG_PACKET, header=bag_messages.image(stamp_ns(i), picture(0), 'bgr8').header,
        width=160, height=128, encoding=f'{codec};yuv420p;bgr8;bgr8', pts=i, flags=0,
        is_bigendian=False, data=np.frombuffer(data, np.uint8),
    )  # fmt: skip


def foxglove(i: int, data: bytes, codec: str) -> Message:
    """Return the message of Foxglove."""
    header = bag_messages.image(stamp_ns(i), picture(0), 'bgr8').header
    return new_message(
        COMPRESSED_VIDEO, timestamp=header.stamp, frame_id=header.frame_id,
        data=np.frombuffer(data, np.uint8), format=codec,
    )  # fmt: skip


def compressed(i: int, data: bytes, codec: str) -> Message:
    """Return a CompressedImage whose format is that of a video."""
    return bag_messages.compressed_image(stamp_ns(i), data, codec)


KINDS: dict[str, Callable[[int, bytes, str], Message]] = {
    FFMPEG_PACKET: ffmpeg, COMPRESSED_VIDEO: foxglove, COMPRESSED_IMAGE: compressed,
}  # fmt: skip


def write(path: Path, kind: str, codec: str, data: list[bytes]) -> Path:
    """Write a bag of a video with depth that names the number of the image."""
    color = {FFMPEG_PACKET: 'ffmpeg', COMPRESSED_VIDEO: 'video', COMPRESSED_IMAGE: 'compressed'}
    name = f'/camera/color/image_raw/{color[kind]}'
    depth_name, info_name = '/camera/depth/image_raw', '/camera/color/camera_info'
    with BagWriter(path) as writer:
        for topic, type_name in ((name, kind), (depth_name, IMAGE), (info_name, CAMERA_INFO)):
            writer.add_topic(topic, type_name)
        for i, packet in enumerate(data):
            ns = stamp_ns(i)
            writer.write(info_name, ns, bag_messages.camera_info(ns, CAMERA))
            writer.write(name, ns, KINDS[kind](i, packet, codec))
            depth = np.full((128, 160), 1000 + i, np.uint16)
            writer.write(depth_name, ns, bag_messages.image(ns, depth, '16UC1'))
    return path


def numbers(path: Path) -> list[int]:
    """Return the numbers of the images of a bag, and check that depth belongs to them."""
    found = []
    for frame in open_sequence(path):
        i = round((float(frame.image_bgr[:, 0].mean()) - picture(0)[0, 0, 0]) / _STEP)
        assert np.abs(frame.image_bgr.astype(int) - picture(i)).mean() < _LOSS
        assert round(1000 * float(frame.depth_m[0, 0])) == 1000 + i
        assert frame.stamp_ns == stamp_ns(i)
        found.append(i)
    return found


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(('encoder', 'codec'), [('libx264', 'h264'), ('libx265', 'h265')])
def test_every_image_of_a_video_is_read(
    kind: str, encoder: str, codec: str, tmp_path: Path
) -> None:
    path = write(tmp_path / 'bag', kind, codec, packets(encoder))
    assert numbers(path) == list(range(NUM))
    assert open_sequence(path).camera == CAMERA
    assert kind in describe(summarize(path))


def test_packets_before_the_first_key_frame_give_no_image(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', FFMPEG_PACKET, 'libx264', packets('libx264'))
    late = tmp_path / 'late'
    with BagReader(path) as reader, BagWriter(late) as writer:
        for topic in reader.topics:
            writer.add_topic(topic.name, topic.type_name)
        for message in reader.messages():
            if message.log_ns >= stamp_ns(4):
                writer.write_serialized(message.topic, message.log_ns, message.data)
    assert numbers(late) == list(range(10, NUM))  # key frames are the 0th, 10th and 20th


def test_a_damaged_packet_costs_no_image_after_the_next_key_frame(tmp_path: Path) -> None:
    data = packets('libx264')
    data[13] = b'\0\0\0\1' + bytes(40)
    found = numbers(write(tmp_path / 'bag', COMPRESSED_VIDEO, 'h264', data))
    assert set(range(13)) | set(range(20, NUM)) <= set(found)


def test_a_video_is_converted_to_images(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', FFMPEG_PACKET, 'libx264', packets('libx264'))
    assert copy_bag(path, tmp_path / 'copy', expand=True) is None
    kinds = {topic.type_name for topic in summarize(tmp_path / 'copy').topics}
    assert kinds == {IMAGE, CAMERA_INFO}
    assert numbers(tmp_path / 'copy') == list(range(NUM))


@pytest.mark.parametrize('kind', KINDS)
def test_without_pyav_the_line_names_topic_format_and_extra(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find_spec(_: str) -> ModuleSpec | None:
        return None

    monkeypatch.setattr('hoid_bags.storage.video.find_spec', find_spec)
    path = write(tmp_path / 'bag', kind, 'h265', packets('libx265'))
    with pytest.raises(
        InputError,
        match=r'/color/image_raw/\w+: is hevc video, which needs the extra "video": \./hoid',
    ):
        open_sequence(path)
    summarize(path)


def test_a_codec_that_is_unknown_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', COMPRESSED_VIDEO, 'mystery', [b'x' * 20] * 3)
    with pytest.raises(InputError, match='no decoder for mystery video'):
        open_sequence(path)


def rgbd_bag(path: Path) -> Path:
    """Write a recording of realsense2_camera with the topic rgbd only."""
    info = bag_messages.camera_info(10**9, CAMERA)
    with BagWriter(path) as writer:
        writer.add_topic('/camera/camera/rgbd', RGBD)
        for i in range(5):
            rgb = bag_messages.image(stamp_ns(i), picture(i)[..., ::-1].copy(), 'rgb8')
            depth = np.full((128, 160), 1000 + i, np.uint16)
            message = new_message(
                RGBD, header=rgb.header, rgb_camera_info=info, depth_camera_info=info, rgb=rgb,
                depth=bag_messages.image(stamp_ns(i), depth, '16UC1'),
            )  # fmt: skip
            writer.write('/camera/camera/rgbd', stamp_ns(i), message)
    return path


def test_rgbd_of_realsense_is_read_as_the_only_source(tmp_path: Path) -> None:
    path = rgbd_bag(tmp_path / 'bag')
    sequence = open_sequence(path)
    assert sequence.camera == CAMERA
    assert numbers(path) == list(range(5))
    copy_bag(path, tmp_path / 'copy', expand=True)
    assert numbers(tmp_path / 'copy') == list(range(5))
    assert [topic.type_name for topic in summarize(path).topics] == [RGBD]
