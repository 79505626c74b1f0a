"""The topics that `ros2 bag record -a` leaves of each driver: color and depth are found."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from backports import zstd
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_topics import TopicChoice, find_topics
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.sequence import open_sequence
from hoid_bags.storage import bag_types
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.errors import InputError
from hoid_common.io import images
from hoid_common.values import CameraModel

CAMERA = CameraModel(32, 24, 30, 30, 15.5, 11.5)
COLOR = np.full((24, 32, 3), 90, np.uint8)
GRAY = COLOR[..., 0].copy()
DEPTH = np.full((24, 32), 1500, np.uint16)
JPEG, PNG = (cv2.imencode(s, p)[1].tobytes() for s, p in (('.jpg', COLOR), ('.png', DEPTH)))

# A line for each topic: preset, topic, encoding, "smaller" than color or not, what it is used as.
RECORDED = Path(__file__).with_name('driver_topics.txt')
PIXELS: dict[str, NDArray[Any]] = {
    'rgb8': COLOR, 'bgr8': COLOR, 'bgra8': np.dstack([COLOR, GRAY]), 'mono8': GRAY,
    'mono16': DEPTH, '16UC1': DEPTH, '32FC1': DEPTH / np.float32(1000),
}  # fmt: skip


class Recorded(NamedTuple):
    """An image topic of a driver."""

    encoding: str
    is_small: bool = False  # half the size of the color images
    used_as: str = ''


def recorded_drivers() -> dict[str, dict[str, Recorded]]:
    """Return the topics of each driver."""
    drivers: dict[str, dict[str, Recorded]] = {}
    for line in RECORDED.read_text(encoding='utf-8').splitlines():
        preset, topic, encoding, *more = line.split()
        used_as = ''.join(word for word in more if word != 'smaller')
        drivers.setdefault(preset, {})[topic] = Recorded(encoding, 'smaller' in more, used_as)
    return drivers


DRIVERS = recorded_drivers()
C, G, D, S = Recorded('rgb8'), Recorded('mono8'), Recorded('16UC1'), Recorded('16UC1', True)
UNKNOWN = {
    '/front/color': C, '/front/depth_aligned': D, '/detector/debug_image': C,
    '/front/depth_confidence': D,
}  # fmt: skip


def write(path: Path, topics: dict[str, Recorded], infos: set[str]) -> Path:
    """Write one message of each topic, in every encoding of image_transport."""
    with BagWriter(path) as writer:

        def put(name: str, type_name: str, message: Any) -> None:
            writer.add_topic(name, type_name)
            writer.write(name, 10**9, message)

        for name, (encoding, is_small, _) in topics.items():
            pixels = PIXELS[encoding][:: 1 + is_small, :: 1 + is_small].copy()
            put(name, bag_types.IMAGE, bag_messages.image(10**9, pixels, encoding))
            if encoding == '32FC1':
                continue
            is_depth = encoding == '16UC1'
            png = cv2.imencode('.png', pixels)[1].tobytes()
            jpeg = cv2.imencode('.jpg', pixels[..., :3] if pixels.ndim == 3 else pixels)[1]
            data, text = (png, '16UC1; png compressed ') if is_depth else (
                jpeg.tobytes(), f'{encoding}; jpeg compressed bgr8'
            )  # fmt: skip
            packed = bag_messages.compressed_image(10**9, data, text)
            put(f'{name}/compressed', bag_types.COMPRESSED_IMAGE, packed)
            if is_depth:
                data, text = images.compressed_depth_of_png(png), images.COMPRESSED_DEPTH_FORMAT
                packed = bag_messages.compressed_image(10**9, data, text)
                put(f'{name}/compressedDepth', bag_types.COMPRESSED_IMAGE, packed)
        for name in sorted(infos):
            put(name, bag_types.CAMERA_INFO, bag_messages.camera_info(10**9, CAMERA))
    return path


def beside(topics: Iterable[str]) -> set[str]:
    names = {name.replace('/image/data', '/info/x') for name in topics}  # RealSense Viewer
    return {f'{name.rpartition("/")[0]}/camera_info' for name in names}


def test_the_topics_of_every_driver_are_listed() -> None:
    assert set(DRIVERS) == set(CAMERA_TOPICS) - {'bag', 'tum'}


@pytest.mark.parametrize('driver', DRIVERS)
def test_the_topics_of_a_driver_are_found_without_an_option(driver: str, tmp_path: Path) -> None:
    topics, expected = DRIVERS[driver], CAMERA_TOPICS[driver].topics()
    used = {recorded.used_as: name for name, recorded in topics.items()}
    assert (used['color'], used['depth']) == expected[:2]
    assert choice(write(tmp_path / 'bag', topics, beside(topics))) == expected


def test_the_topics_of_an_unknown_driver_are_found_by_their_names(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', UNKNOWN, {'/camera_info'})
    assert choice(path) == ('/front/color', '/front/depth_aligned', '/camera_info')


def choice(path: Path) -> tuple[str, ...]:
    """Return the topics that are chosen without an option, and check their only frame."""
    sequence = open_sequence(path)
    found = sequence.topics  # type: ignore[attr-defined]
    (frame,) = sequence
    assert frame.depth_m[0, 0] == 1.5
    assert frame.image_bgr.shape == COLOR.shape
    return found.color.name, found.depth.name, found.camera_info.name


RVL = '16UC1; compressedDepth rvl'
# A size, then 0 zeros, 768 other pixels, the first of them 1500, and 767 differences of 0.
RVL_OF_DEPTH = bytes.fromhex('2000000018000000fe188c0800000050') + bytes(380)


def zstd_image(pixels: NDArray[Any], encoding: str) -> bytes:
    """Return the data of zstd_image_transport."""
    step, name = pixels.nbytes // len(pixels), encoding.encode()
    head = struct.pack('<IIBII', *pixels.shape[:2], 0, step, len(name))
    return head + name + zstd.compress(pixels.tobytes())


TIFF = cv2.imencode('.tiff', DEPTH)[1].tobytes()


@pytest.mark.parametrize(
    ('suffix', 'text', 'packed'),
    [
        ('/compressed', '16UC1; png compressed ', PNG),
        ('/compressed', '16UC1; tiff compressed ', TIFF),
        ('/compressedDepth', images.COMPRESSED_DEPTH_FORMAT, images.compressed_depth_of_png(PNG)),
        ('/compressedDepth', RVL, bytes(12) + RVL_OF_DEPTH),
        ('/zstd', 'zstd', zstd_image(DEPTH, '16UC1')),
    ],
)
def test_depth_is_found_in_each_encoding_of_image_transport(
    suffix: str, text: str, packed: bytes, tmp_path: Path
) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        color_name = 'rgb/image/zstd' if suffix == '/zstd' else 'rgb/image/compressed'
        writer.add_topic(color_name, bag_types.COMPRESSED_IMAGE)
        writer.add_topic(f'depth/image{suffix}', bag_types.COMPRESSED_IMAGE)
        color = bag_messages.compressed_image(10**9, JPEG, 'rgb8; jpeg compressed bgr8')
        if suffix == '/zstd':
            color = bag_messages.compressed_image(10**9, zstd_image(COLOR, 'bgr8'), 'zstd')
        writer.write(color_name, 10**9, color)
        depth = bag_messages.compressed_image(10**9, packed, text)
        writer.write(f'depth/image{suffix}', 10**9, depth)
    frame = next(iter(open_sequence(tmp_path / 'bag', CAMERA)))
    assert (frame.depth_m == 1.5).all()
    assert np.abs(frame.image_bgr.astype(int) - 90).max() <= 2


def test_two_cameras_need_an_option_and_the_rest_follows_it(tmp_path: Path) -> None:
    topics = {
        f'/{side}/{name}/image_raw': kind
        for side in ('front', 'back')
        for name, kind in (('color', C), ('depth', D))
    }
    infos = {f'/{side}/color/camera_info' for side in ('front', 'back')}
    path = write(tmp_path / 'bag', topics, infos)
    with pytest.raises(InputError, match=r'several topics could be color: .*; give --rgb TOPIC'):
        open_sequence(path)
    with BagReader(path) as reader:
        found = find_topics(reader, TopicChoice(color='back/color/image_raw'))
        assert str(found) == (
            'color /back/color/image_raw, depth /back/depth/image_raw, '
            'camera_info /back/color/camera_info'
        )
        for option, choice in (
            ('--rgb', TopicChoice(color='/none')),
            ('--depth', TopicChoice('/back/color/image_raw', '/back/color/image_raw')),
            ('--info', TopicChoice('/back/color/image_raw', camera_info='/none')),
        ):
            with pytest.raises(InputError, match=f'{option} .*: has no such'):
                find_topics(reader, choice)


def test_a_preset_chooses_among_drivers(tmp_path: Path) -> None:
    topics = DRIVERS['realsense'] | DRIVERS['azure_kinect']
    path = write(tmp_path / 'bag', topics, {'/rgb/camera_info'})
    with BagReader(path) as reader:
        found = find_topics(reader, TopicChoice(preset='azure_kinect'))
        assert (found.color.name, found.depth.name) == (
            '/rgb/image_raw',
            '/depth_to_rgb/image_raw',
        )
        found = find_topics(reader, TopicChoice(preset='realsense'))
        assert found.color.name == '/camera/camera/color/image_raw'


def test_depth_that_is_not_registered_is_named_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    topics = {'/camera/color/image_raw': C, '/camera/depth/image_raw': S}
    monkeypatch.setitem(PIXELS, '16UC1', DEPTH[:, :30])
    path = write(tmp_path / 'bag', topics, {'/camera/color/camera_info'})
    reason = (
        'depth is not registered to color: it is 15x12, color 32x24; register it in the driver'
    )
    with pytest.raises(InputError, match=reason):
        list(open_sequence(path))


def test_one_image_that_cannot_be_decoded_costs_only_itself(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('rgb/image/compressed', bag_types.COMPRESSED_IMAGE)
        writer.add_topic('depth/image', bag_types.IMAGE)
        for i in range(5):
            stamp_ns = 10**9 + i * 33_000_000
            data = JPEG[:100] if i == 2 else JPEG
            color = bag_messages.compressed_image(stamp_ns, data, 'jpeg')
            writer.write('rgb/image/compressed', stamp_ns, color)
            writer.write('depth/image', stamp_ns, bag_messages.image(stamp_ns, DEPTH, '16UC1'))
    sequence = open_sequence(tmp_path / 'bag', CAMERA)
    assert sequence.fault is None
    assert len(list(sequence)) == 4
    assert sequence.fault is not None
    assert sequence.fault.startswith('1 images left out; ')
    assert 'truncated image' in sequence.fault
