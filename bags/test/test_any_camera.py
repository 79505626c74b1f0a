"""Recordings of cameras whose stamps, units or calibration are unusual: right, or one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.sequence import open_sequence
from hoid_bags.storage import bag_types
from hoid_common.errors import InputError
from hoid_common.io.depth import MAX_DEPTH_M, MIN_DEPTH_M
from hoid_common.values import CameraModel

CAMERA = CameraModel(160, 120, 150, 151, 79.5, 59.5)
HALF = CameraModel(80, 60, 75, 75.5, 39.5, 29.5)
ZOOMED = replace(CAMERA, fx_px=180.0, fy_px=181.0)
DISTORTED = replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
NUM, START_NS = 80, 10**9
Depth = Callable[[int], NDArray[Any]]


def stamp_ns(i: int) -> int:
    """Return the stamp of image i at about 30 Hz, with the jitter of a real clock."""
    return START_NS + i * 33_000_000 + (i * 7 % 5) * 300_000


def millimeters(i: int, camera: CameraModel = CAMERA) -> NDArray[Any]:
    """Return depth by which the image is known."""
    return np.full((camera.height_px, camera.width_px), 1000 + i, np.uint16)


def write(
    path: Path,
    camera_of: Callable[[int], CameraModel] = lambda _: CAMERA,
    image_camera_of: Callable[[int], CameraModel] = lambda _: CAMERA,
    depth_of: Depth | None = None,
    offset_ns: int = 0,
) -> Path:
    """Write a bag of NUM images with their depth and camera info."""
    with BagWriter(path) as writer:
        names = ('rgb/camera_info', 'rgb/image', 'depth/image')
        for name, type_name in zip(
            names, (bag_types.CAMERA_INFO, bag_types.IMAGE, bag_types.IMAGE), strict=True
        ):
            writer.add_topic(name, type_name)
        for i in range(NUM):
            ns, seen = stamp_ns(i), image_camera_of(i)
            color = np.full((seen.height_px, seen.width_px, 3), i, np.uint8)
            depth = millimeters(i, seen) if depth_of is None else depth_of(i)
            encoding = '16UC1' if depth.dtype == np.uint16 else '32FC1'
            writer.write(names[0], ns, bag_messages.camera_info(ns, camera_of(i)))
            writer.write(names[1], ns, bag_messages.image(ns, color, 'bgr8'))
            writer.write(names[2], ns, bag_messages.image(ns + offset_ns, depth, encoding))
    return path


def after_half(first: CameraModel, second: CameraModel) -> Callable[[int], CameraModel]:
    return lambda i: first if i < NUM // 2 else second


@pytest.mark.parametrize('other', [ZOOMED, HALF, DISTORTED])
def test_a_camera_info_that_changes_is_reported_once_and_the_first_is_kept(
    other: CameraModel, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sequence = open_sequence(write(tmp_path / 'bag', after_half(CAMERA, other)))
    assert sequence.camera == CAMERA
    assert len(list(sequence)) == NUM
    assert sequence.fault is None
    (line,) = [text for text in caplog.messages if 'camera_info has changed' in text]
    assert 'the first is kept' in line
    assert '--calibration' in line


def test_a_camera_that_changes_its_size_is_reported_and_other_images_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    changing = after_half(CAMERA, HALF)
    sequence = open_sequence(write(tmp_path / 'bag', changing, changing))
    assert sequence.camera == CAMERA
    assert len(list(sequence)) == NUM // 2
    assert sum('camera_info has changed' in text for text in caplog.messages) == 1
    assert sequence.fault is not None
    assert sequence.fault.startswith(f'{NUM // 2} images left out')


@pytest.mark.parametrize('first', [ZOOMED, HALF])
def test_a_wrong_camera_info_at_the_start_is_replaced(first: CameraModel, tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', lambda i: first if i < 2 else CAMERA)
    assert open_sequence(path).camera == CAMERA


def test_a_constant_offset_is_offered_and_then_pairs_the_right_images(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / 'bag', offset_ns=25_000_000)
    paired = [frame.depth_m[0, 0] - 1 for frame in open_sequence(path)]
    assert np.rint(paired[10] * 1000) == 10  # of the image before: silent without the line below
    (line,) = [text for text in caplog.messages if 'the stamps of depth' in text]
    assert 'always +25.0 ms from those of color' in line
    assert 'set --depth-offset 0.0250' in line
    caplog.clear()
    shifted = open_sequence(path, depth_offset_ns=25_000_000)
    frames = list(shifted)
    assert len(frames) == NUM
    for i, frame in enumerate(frames):
        assert frame.image_bgr[0, 0, 0] == i
        assert np.rint(1000 * frame.depth_m[0, 0]) == 1000 + i
    assert caplog.messages == []


@pytest.mark.parametrize('units_per_m', [10_000.0, 100.0])
def test_other_units_of_depth_are_doubted_and_can_be_named(
    units_per_m: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def depth_of(_: int) -> NDArray[Any]:
        return np.full((120, 160), 1.5 * units_per_m, np.uint16)

    path = write(tmp_path / 'bag', depth_of=depth_of)
    list(open_sequence(path))
    (line,) = caplog.messages
    assert f'median of {1.5 * units_per_m / 1000:.2f} m' in line
    assert '--depth-factor' in line
    caplog.clear()
    frames = list(open_sequence(path, depth_units_per_m=units_per_m))
    assert {float(frame.depth_m[0, 0]) for frame in frames} == {1.5}
    assert caplog.messages == []


def test_depth_in_meters_over_a_thousand_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', depth_of=lambda _: np.full((120, 160), 0.0015, np.float32))
    with pytest.raises(InputError, match=r'median of 0\.0015 m, so its unit is wrong'):
        list(open_sequence(path))


def test_a_folder_with_the_factor_of_another_camera_is_doubted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for kind in ('rgb', 'depth'):
        (tmp_path / kind).mkdir()
        lines = []
        for i in range(12):
            pixels = np.full((120, 160), 1000, np.uint16) if kind == 'depth' else np.zeros(
                (120, 160, 3), np.uint8
            )  # fmt: skip
            cv2.imwrite(str(tmp_path / kind / f'{i}.png'), pixels)
            lines.append(f'{1 + i / 30:.6f} {kind}/{i}.png')
        (tmp_path / f'{kind}.txt').write_text('\n'.join(lines) + '\n')
    list(open_sequence(tmp_path, CAMERA))  # 1 m at 1000 units per meter
    (line,) = caplog.messages
    assert 'median of 0.20 m' in line
    assert line.endswith('set --depth-factor')
    caplog.clear()
    list(open_sequence(tmp_path, CAMERA, 1000.0))
    assert caplog.messages == []


def encoded(encoding: str) -> NDArray[Any]:
    """Return the pixels of a gray image of value 120 in an encoding of color."""
    if encoding == 'mono16':
        return np.full((120, 160), 120 << 8, np.uint16)
    if encoding == 'nv24':
        return np.vstack(
            [np.full((120, 160), 120 * 219 // 255 + 16), np.full((240, 160), 128)]
        ).astype(np.uint8)
    if encoding in ('nv12', 'i420'):
        planes = cv2.cvtColor(np.full((120, 160, 3), 120, np.uint8), cv2.COLOR_BGR2YUV_I420)
        return planes.astype(np.uint8)  # gray: U and V are all 128, in any order
    if encoding == 'yuv422':
        luma = cv2.cvtColor(np.full((2, 2, 3), 120, np.uint8), cv2.COLOR_BGR2YUV_I420)[0, 0]
        return np.tile(np.array([128, luma], np.uint8), (120, 160))
    return np.full((120, 160), 120, np.uint8)  # Bayer


@pytest.mark.parametrize('depth_encoding', ['64FC1', '16SC1'])
@pytest.mark.parametrize(
    'encoding', ['mono16', 'bayer_rggb8', 'bayer_gbrg8', 'yuv422', 'nv12', 'i420', 'nv24']
)
def test_unusual_encodings_are_read(encoding: str, depth_encoding: str, tmp_path: Path) -> None:
    color, depth = '/camera/color/image_raw', '/camera/aligned_depth_to_color/image_raw'
    depth_of = {'64FC1': np.full((120, 160), 1.5), '16SC1': np.full((120, 160), 1500, np.int16)}
    with BagWriter(tmp_path / 'bag') as writer:
        for name in (color, depth):
            writer.add_topic(name, bag_types.IMAGE)
        message = bag_messages.image(START_NS, encoded(encoding), encoding)
        message.height, message.width = 120, 160
        writer.write(color, START_NS, message)
        message = bag_messages.image(START_NS, depth_of[depth_encoding], depth_encoding)
        writer.write(depth, START_NS, message)
    (frame,) = open_sequence(tmp_path / 'bag', CAMERA)
    assert np.abs(frame.image_bgr.astype(int) - 120).max() <= 2
    assert (frame.depth_m == 1.5).all()


def test_depth_outside_the_range_of_readings_is_none(tmp_path: Path) -> None:
    stray_m = np.array([1e5, 1e-4, 1e30, np.inf, np.nan, -1, MAX_DEPTH_M * 1.01, 0], np.float32)
    kept_m = np.array([MIN_DEPTH_M, MAX_DEPTH_M], np.float32)

    def depth_of(_: int) -> NDArray[Any]:
        depth_m = np.full((120, 160), 1.5, np.float32)
        depth_m[1, :8], depth_m[1, 8:10] = stray_m, kept_m
        return depth_m

    for frame in open_sequence(write(tmp_path / 'bag', depth_of=depth_of)):
        np.testing.assert_array_equal(frame.depth_m[1, :8], 0)
        np.testing.assert_array_equal(frame.depth_m[1, 8:10], kept_m)
        assert (frame.depth_m[2:] == 1.5).all()


@pytest.mark.parametrize('factor', [2, 3])
def test_registered_depth_of_a_fraction_of_the_size_is_used(factor: int, tmp_path: Path) -> None:
    color = CameraModel(150, 120, 150, 150, 74.5, 59.5)
    small = color.scaled_to((150 // factor, 120 // factor))
    assert small is not None
    rng = np.random.default_rng(0)
    pixels = rng.integers(500, 3000, (small.height_px, small.width_px)).astype(np.uint16)
    path = write(tmp_path / 'bag', lambda _: color, lambda _: color, lambda _: pixels)
    sequence = open_sequence(path)
    frame = next(iter(sequence))
    assert sequence.camera == color
    expected = np.kron(pixels, np.ones((factor, factor))) / 1000
    np.testing.assert_allclose(frame.depth_m, expected, atol=1e-6)


def test_a_camera_info_of_twice_the_size_is_scaled(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    twice = CAMERA.scaled_to((320, 240))
    assert twice is not None
    sequence = open_sequence(write(tmp_path / 'bag', lambda _: twice))
    assert sequence.camera == CAMERA
    assert len(list(sequence)) == NUM
    (line,) = caplog.messages
    assert 'camera_info is of 320x240 px, images are of 160x120 px' in line


def test_a_camera_info_of_no_multiple_is_not_denied(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', lambda _: replace(CAMERA, width_px=200))
    with pytest.raises(InputError, match=r'image is 160x120, the camera 200x120; .*--calibration'):
        list(open_sequence(path))
    late = tmp_path / 'late'
    with BagWriter(late) as writer, BagReader(path) as reader:
        for topic in reader.topics:
            writer.add_topic(topic.name, topic.type_name)
        for message in reader.messages():
            is_info = message.topic == '/rgb/camera_info'
            writer.write_serialized(message.topic, message.log_ns + is_info, message.data)
    with pytest.raises(
        InputError,
        match=r'camera_info is of 200x120 px, images are of 160x120 px: .*--calibration',
    ):
        open_sequence(late)
