import struct
import zlib
from array import array
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.io import images

COLOR = np.array([[[10, 20, 30], [40, 50, 60]], [[70, 80, 90], [5, 6, 7]]], np.uint8)


def message(
    pixels: NDArray[Any], encoding: str, *, padding: int = 0, bigendian: bool = False
) -> SimpleNamespace:
    """An image message with some bytes of padding at the end of each row."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return SimpleNamespace(
        height=len(pixels),
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(bigendian),
        step=padded.shape[1],
        data=array('B', padded.tobytes()),
    )


@pytest.mark.parametrize('padding', [0, 5])
def test_bgr8_is_taken_as_it_is(padding: int) -> None:
    np.testing.assert_array_equal(
        images.decode_color(message(COLOR, 'bgr8', padding=padding)), COLOR
    )


def test_rgb8_is_turned_round() -> None:
    np.testing.assert_array_equal(images.decode_color(message(COLOR, 'rgb8'))[0, 0], [30, 20, 10])


def test_mono8_becomes_grey() -> None:
    np.testing.assert_array_equal(
        images.decode_color(message(COLOR[..., 0], 'mono8', padding=3))[1, 0], [70, 70, 70]
    )


def test_bgra8_loses_its_alpha() -> None:
    bgra = np.dstack([COLOR, np.full((2, 2), 9, np.uint8)])
    np.testing.assert_array_equal(images.decode_color(message(bgra, 'bgra8')), COLOR)


@pytest.mark.parametrize('bigendian', [False, True])
@pytest.mark.parametrize('padding', [0, 6])
def test_millimetres_become_metres(bigendian: bool, padding: int) -> None:
    depth_mm = np.array([[0, 1000, 65535], [1, 1234, 500]], '>u2' if bigendian else '<u2')
    depth_m = images.decode_depth(message(depth_mm, '16UC1', padding=padding, bigendian=bigendian))
    assert depth_m.dtype == np.float32
    np.testing.assert_array_equal(
        depth_m, np.array([[0, 1, 65.535], [0.001, 1.234, 0.5]], np.float32)
    )


@pytest.mark.parametrize('bigendian', [False, True])
def test_unusable_metres_become_no_reading(bigendian: bool) -> None:
    depth = np.array([[1.5, np.nan, np.inf, -1.0, 0.0]], '>f4' if bigendian else '<f4')
    depth_m = images.decode_depth(message(depth, '32FC1', bigendian=bigendian))
    np.testing.assert_array_equal(depth_m, np.array([[1.5, 0, 0, 0, 0]], np.float32))
    assert depth_m.dtype.isnative


@given(arrays(np.float32, (3, 5), elements=st.floats(width=32)))
def test_metres_are_kept_where_they_are_a_distance(depth: NDArray[np.float32]) -> None:
    depth_m = images.decode_depth(message(depth, '32FC1'))
    expected = np.where((depth > 0) & (depth < np.inf), depth, np.float32(0))
    assert depth_m.tobytes() == expected.tobytes()


def test_metres_that_need_no_change_are_not_copied() -> None:
    image = message(np.array([[1.5, 0.0, 2.0]], np.float32), '32FC1')
    assert np.shares_memory(images.decode_depth(image), np.frombuffer(image.data, np.uint8))


def with_fields(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**(vars(message(COLOR, 'bgr8')) | fields))


@pytest.mark.parametrize(
    ('image', 'said'),
    [
        (with_fields(encoding='yuv422'), 'encoding "yuv422"'),
        (with_fields(height=0), 'is empty: 2x0 px'),
        (with_fields(step=5), 'step 5, but 2 px take 6'),
        (with_fields(data=array('B', [0] * 11)), 'holds 11 bytes, 2x2 px at step 6 take 12'),
    ],
)
def test_contradictions_are_named(image: Any, said: str) -> None:
    with pytest.raises(MessageError, match=said):
        images.decode_color(image)


def test_colour_is_no_depth() -> None:
    with pytest.raises(MessageError, match='use 16UC1'):
        images.decode_depth(message(COLOR, 'bgr8'))


@given(arrays(np.uint16, (4, 5)))
def test_compressed_depth_loses_nothing(depth_mm: NDArray[np.uint16]) -> None:
    data = images.encode_compressed_depth(depth_mm)
    depth_m = images.decode_compressed_depth(images.COMPRESSED_DEPTH_FORMAT, data)
    np.testing.assert_array_equal(images.depth_mm_or_none(depth_m), depth_mm)


def test_inverse_depth_is_understood() -> None:
    # What compressed_depth_image_transport writes for 32FC1: A / depth + B, rounded.
    quant_a, quant_b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    truth = np.array([[1.0, 2.0, 5.0]])
    png = cv2.imencode(
        '.png', np.append(np.rint(quant_a / truth + quant_b), 0)[None].astype(np.uint16)
    )[1]
    data = images._COMPRESSED_DEPTH_HEADER.pack(0, quant_a, quant_b) + png.tobytes()
    depth_m = images.decode_compressed_depth('32FC1; compressedDepth png', data)
    np.testing.assert_allclose(depth_m, [[1, 2, 5, 0]], rtol=2e-3)


@pytest.mark.parametrize(
    ('format_', 'data', 'said'),
    [
        ('16UC1; compressedDepth rvl', b'x' * 20, 'rvl'),
        ('jpeg', b'x' * 20, '"jpeg"'),
        ('16UC1; compressedDepth png', b'x' * 12, '12 bytes, too few'),
        ('16UC1; compressedDepth png', b'x' * 40, '28 bytes is not a readable'),
        (
            '16UC1; compressedDepth png',
            bytes(12) + cv2.imencode('.png', COLOR)[1].tobytes(),
            'not one 16-bit channel',
        ),
    ],
)
def test_bad_compressed_depth_is_named(format_: str, data: bytes, said: str) -> None:
    with pytest.raises(MessageError, match=said):
        images.decode_compressed_depth(format_, data)


def test_jpeg_round_trip_is_close() -> None:
    picture = np.full((16, 16, 3), (50, 100, 150), np.uint8)
    decoded = images.decode_compressed_color(images.encode_jpeg(picture, 95))
    assert np.abs(decoded.astype(int) - picture).max() <= 2


def test_an_empty_jpeg_is_named() -> None:
    with pytest.raises(MessageError, match='compressed colour image of 0 bytes'):
        images.decode_compressed_color(b'')


def png_said_to_be_of(side_px: int, pixels: NDArray[Any]) -> bytes:
    """A PNG whose header says another size."""
    png = cv2.imencode('.png', pixels)[1].tobytes()
    header = b'IHDR' + struct.pack('>II', side_px, side_px) + png[24:29]
    return png[:12] + header + struct.pack('>I', zlib.crc32(header)) + png[33:]


def test_more_pixels_than_any_camera_gives_are_named() -> None:
    said = 'says to be 60000x60000 px, more than 33 megapixels$'
    with pytest.raises(MessageError, match=rf'^compressed colour image .* {said}'):
        images.decode_compressed_color(png_said_to_be_of(60_000, COLOR))
    depth = bytes(12) + png_said_to_be_of(60_000, np.ones((2, 2), np.uint16))
    with pytest.raises(MessageError, match=rf'^compressed depth .* {said}'):
        images.decode_compressed_depth(images.COMPRESSED_DEPTH_FORMAT, depth)


@given(st.integers(0, 65535))
def test_whole_millimetres_are_recognised(depth_mm: NDArray[np.uint16]) -> None:
    depth_m = np.full((1, 1), depth_mm, np.float32) / np.float32(1000)
    np.testing.assert_array_equal(images.depth_mm_or_none(depth_m), [[depth_mm]])


@pytest.mark.parametrize('depth_m', [1.0002, 70.0])
def test_other_depths_are_not_millimetres(depth_m: float) -> None:
    assert images.depth_mm_or_none(np.full((1, 1), depth_m, np.float32)) is None
