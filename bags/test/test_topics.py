"""The topics that `ros2 bag record -a` leaves of each driver: color and depth are found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages, bag_types
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_topics import TopicChoice, find_topics
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.sequence import open_sequence
from hoid_common.errors import InputError
from hoid_common.io import images
from hoid_common.values import CameraModel

CAMERA = CameraModel(32, 24, 30, 30, 15.5, 11.5)
COLOR = np.full((24, 32, 3), 90, np.uint8)
GRAY = COLOR[..., 0].copy()
DEPTH = np.full((24, 32), 1500, np.uint16)
SMALL_DEPTH = DEPTH[::2, ::2].copy()
JPEG, PNG = (cv2.imencode(s, p)[1].tobytes() for s, p in (('.jpg', COLOR), ('.png', DEPTH)))

# Topics by driver: color (c), gray (g), depth (d), depth of another size (s); the expected color,
# depth and camera_info.
Driver = tuple[dict[str, str], tuple[str, str, str]]
DRIVERS: dict[str, Driver] = {
    'realsense': (
        {
            '/camera/camera/color/image_raw': 'c',
            '/camera/camera/aligned_depth_to_color/image_raw': 'd',
            '/camera/camera/depth/image_rect_raw': 'd',
            '/camera/camera/infra1/image_rect_raw': 'g',
            '/camera/camera/infra2/image_rect_raw': 'g',
        },
        (
            '/camera/camera/color/image_raw',
            '/camera/camera/aligned_depth_to_color/image_raw',
            '/camera/camera/color/camera_info',
        ),
    ),
    'orbbec': (
        {
            '/camera/color/image_raw': 'c', '/camera/depth/image_raw': 'd',
            '/camera/ir/image_raw': 'g',
        },
        ('/camera/color/image_raw', '/camera/depth/image_raw', '/camera/color/camera_info'),
    ),
    'azure_kinect': (
        {
            '/rgb/image_raw': 'c', '/depth_to_rgb/image_raw': 'd', '/depth/image_raw': 's',
            '/rgb_to_depth/image_raw': 'c', '/ir/image_raw': 'g',
        },
        ('/rgb/image_raw', '/depth_to_rgb/image_raw', '/rgb/camera_info'),
    ),
    'oak': (
        {
            '/oak/rgb/image_raw': 'c', '/oak/rgb/image_rect': 'c', '/oak/stereo/image_raw': 'd',
            '/oak/left/image_raw': 'g', '/oak/right/image_raw': 'g',
        },
        ('/oak/rgb/image_raw', '/oak/stereo/image_raw', '/oak/rgb/camera_info'),
    ),
    'zed': (
        {
            '/zed/zed_node/rgb/color/rect/image': 'c', '/zed/zed_node/left/color/rect/image': 'c',
            '/zed/zed_node/right/color/rect/image': 'c', '/zed/zed_node/left/gray/rect/image': 'g',
            '/zed/zed_node/depth/depth_registered': 'd',
            '/zed/zed_node/confidence/confidence_map': 'd',
        },
        (
            '/zed/zed_node/rgb/color/rect/image', '/zed/zed_node/depth/depth_registered',
            '/zed/zed_node/rgb/color/rect/camera_info',
        ),
    ),
    'openni2': (
        {
            '/camera/rgb/image_raw': 'c', '/camera/rgb/image_rect_color': 'c',
            '/camera/depth_registered/image_raw': 'd', '/camera/depth/image_raw': 'd',
            '/camera/ir/image': 'g',
        },
        (
            '/camera/rgb/image_raw', '/camera/depth_registered/image_raw',
            '/camera/rgb/camera_info',
        ),
    ),
    'unknown': (
        {
            '/front/color': 'c', '/front/depth_aligned': 'd', '/detector/debug_image': 'c',
            '/front/depth_confidence': 'd',
        },
        ('/front/color', '/front/depth_aligned', '/camera_info'),
    ),
}  # fmt: skip


def write(path: Path, topics: dict[str, str], infos: set[str]) -> Path:
    """Write one message of each topic, in every encoding of image_transport."""
    with BagWriter(path) as writer:

        def put(name: str, type_name: str, message: Any) -> None:
            writer.add_topic(name, type_name)
            writer.write(name, 10**9, message)

        raw: dict[str, tuple[NDArray[Any], str]] = {
            'c': (COLOR, 'rgb8'),
            'g': (GRAY, 'mono8'),
            'd': (DEPTH, '16UC1'),
            's': (SMALL_DEPTH, '16UC1'),
        }
        for name, kind in topics.items():
            put(name, bag_types.IMAGE, bag_messages.image(10**9, *raw[kind]))
            is_depth = kind in 'ds'
            png = cv2.imencode('.png', raw[kind][0])[1].tobytes()
            for data, text, suffix in (
                (png, '16UC1; png compressed ', 'compressed'),
                (
                    images.compressed_depth_of_png(png),
                    images.COMPRESSED_DEPTH_FORMAT,
                    'compressedDepth',
                ),
            )[: 2 if is_depth else 1]:
                encoded = (data, text) if is_depth else (JPEG, 'rgb8; jpeg compressed bgr8')
                message = bag_messages.compressed_image(10**9, *encoded)
                put(f'{name}/{suffix}', bag_types.COMPRESSED_IMAGE, message)
        for name in sorted(infos):
            put(name, bag_types.CAMERA_INFO, bag_messages.camera_info(10**9, CAMERA))
    return path


@pytest.mark.parametrize('driver', DRIVERS)
def test_the_topics_of_a_driver_are_found_without_an_option(driver: str, tmp_path: Path) -> None:
    topics, expected = DRIVERS[driver]
    beside = {f'{name.rpartition("/")[0]}/camera_info' for name in topics}
    infos = {expected[2]} if driver == 'unknown' else beside | {expected[2]}
    sequence = open_sequence(write(tmp_path / 'bag', topics, infos))
    found = sequence.topics  # type: ignore[attr-defined]
    assert (found.color.name, found.depth.name, found.camera_info.name) == expected
    frames = list(sequence)
    assert len(frames) == 1
    assert frames[0].depth_m[0, 0] == 1.5


@pytest.mark.parametrize('suffix', ['/compressed', '/compressedDepth'])
def test_depth_is_found_in_each_encoding_of_image_transport(suffix: str, tmp_path: Path) -> None:
    packed = PNG if suffix == '/compressed' else images.compressed_depth_of_png(PNG)
    text = '16UC1; png compressed ' if suffix == '/compressed' else images.COMPRESSED_DEPTH_FORMAT
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('rgb/image/compressed', bag_types.COMPRESSED_IMAGE)
        writer.add_topic(f'depth/image{suffix}', bag_types.COMPRESSED_IMAGE)
        color = bag_messages.compressed_image(10**9, JPEG, 'rgb8; jpeg compressed bgr8')
        writer.write('rgb/image/compressed', 10**9, color)
        depth = bag_messages.compressed_image(10**9, packed, text)
        writer.write(f'depth/image{suffix}', 10**9, depth)
    frame = next(iter(open_sequence(tmp_path / 'bag', CAMERA)))
    assert (frame.depth_m == 1.5).all()


def test_two_cameras_need_an_option_and_the_rest_follows_it(tmp_path: Path) -> None:
    topics = {
        f'/{side}/{name}/image_raw': kind
        for side in ('front', 'back')
        for name, kind in (('color', 'c'), ('depth', 'd'))
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
    topics = DRIVERS['realsense'][0] | DRIVERS['azure_kinect'][0]
    path = write(tmp_path / 'bag', topics, {'/rgb/camera_info'})
    with BagReader(path) as reader:
        found = find_topics(reader, TopicChoice(preset='azure_kinect'))
        assert (found.color.name, found.depth.name) == (
            '/rgb/image_raw',
            '/depth_to_rgb/image_raw',
        )
        found = find_topics(reader, TopicChoice(preset='realsense'))
        assert found.color.name == '/camera/camera/color/image_raw'


def test_depth_that_is_not_registered_is_named_so(tmp_path: Path) -> None:
    topics = {'/camera/color/image_raw': 'c', '/camera/depth/image_raw': 's'}
    path = write(tmp_path / 'bag', topics, {'/camera/color/camera_info'})
    with pytest.raises(InputError, match=r'depth is 16x12, color 32x24; register depth to color'):
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
