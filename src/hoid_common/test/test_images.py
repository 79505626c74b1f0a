import struct
import zlib
from array import array
from dataclasses import replace
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
from hoid_common.io.compression import compressed_images
from hoid_common.io.depth import MAX_DEPTH_M, MIN_DEPTH_M

COLOR = np.array([[[10, 20, 30], [40, 50, 60]], [[70, 80, 90], [5, 6, 7]]], np.uint8)


def message(
    pixels: NDArray[Any], encoding: str, *, padding: int = 0, bigendian: bool = False
) -> images.RawImage:
    """Return an image message with padding at the end of each row."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return images.RawImage(
        height=len(pixels),
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(bigendian),
        step=padded.shape[1],
        data=array('B', padded.tobytes()),
    )


@pytest.mark.parametrize('padding', [0, 5])
def test_bgr8_is_unchanged(padding: int) -> None:
    np.testing.assert_array_equal(
        images.decode_color(message(COLOR, 'bgr8', padding=padding)), COLOR
    )


def test_rgb8_becomes_bgr() -> None:
    np.testing.assert_array_equal(images.decode_color(message(COLOR, 'rgb8'))[0, 0], [30, 20, 10])


def test_mono8_becomes_gray() -> None:
    np.testing.assert_array_equal(
        images.decode_color(message(COLOR[..., 0], 'mono8', padding=3))[1, 0], [70, 70, 70]
    )


def test_bgra8_loses_its_alpha() -> None:
    bgra = np.dstack([COLOR, np.full((2, 2), 9, np.uint8)])
    np.testing.assert_array_equal(images.decode_color(message(bgra, 'bgra8')), COLOR)


@pytest.mark.parametrize('bigendian', [False, True])
@pytest.mark.parametrize('padding', [0, 6])
def test_millimeters_become_meters(bigendian: bool, padding: int) -> None:
    depth_mm = np.array([[0, 1000, 65535], [49, 1234, 50]], '>u2' if bigendian else '<u2')
    depth_m = images.decode_depth(message(depth_mm, '16UC1', padding=padding, bigendian=bigendian))
    assert depth_m.dtype == np.float32
    np.testing.assert_array_equal(
        depth_m, np.array([[0, 1, 65.535], [0, 1.234, 0.05]], np.float32)
    )


@pytest.mark.parametrize('bigendian', [False, True])
def test_invalid_depth_becomes_no_reading(bigendian: bool) -> None:
    depth = np.array([[1.5, np.nan, np.inf, -1.0, 0.0]], '>f4' if bigendian else '<f4')
    depth_m = images.decode_depth(message(depth, '32FC1', bigendian=bigendian))
    np.testing.assert_array_equal(depth_m, np.array([[1.5, 0, 0, 0, 0]], np.float32))
    assert depth_m.dtype.isnative


@given(arrays(np.float32, (3, 5), elements=st.floats(width=32)))
def test_valid_depth_in_meters_is_unchanged(depth: NDArray[np.float32]) -> None:
    depth_m = images.decode_depth(message(depth, '32FC1'))
    expected = np.where((depth >= MIN_DEPTH_M) & (depth <= MAX_DEPTH_M), depth, np.float32(0))
    assert depth_m.tobytes() == expected.tobytes()


def test_valid_depth_in_meters_is_not_copied() -> None:
    image = message(np.array([[1.5, 0.0, 2.0]], np.float32), '32FC1')
    assert np.shares_memory(images.decode_depth(image), np.frombuffer(image.data, np.uint8))


def with_fields(**fields: Any) -> images.RawImage:
    return replace(message(COLOR, 'bgr8'), **fields)


@pytest.mark.parametrize(
    ('image', 'expected'),
    [
        (with_fields(encoding='h264'), 'encoding "h264"'),
        (with_fields(height=0), 'is empty: 2x0 px'),
        (with_fields(step=5), 'step 5, but 2 px need 6 bytes'),
        (with_fields(data=array('B', [0] * 11)), 'has 11 bytes, but 2x2 px at step 6 need 12'),
    ],
)
def test_errors_name_the_contradiction(image: Any, expected: str) -> None:
    with pytest.raises(MessageError, match=expected):
        images.decode_color(image)


GRAY = cv2.GaussianBlur(
    np.random.default_rng(3).integers(0, 256, (24, 32), np.uint8).astype(np.uint8), (0, 0), 4
)


@pytest.mark.parametrize(
    ('encoding', 'pixels'),
    [
        ('mono16', GRAY.astype(np.uint16) * 256 + 7),
        ('bgr16', np.dstack([GRAY] * 3).astype(np.uint16) * 256),
        *((f'bayer_{order}8', GRAY) for order in ('rggb', 'bggr', 'gbrg', 'grbg')),
        ('bayer_rggb16', GRAY.astype(np.uint16) * 256),
        ('8UC4', np.dstack([GRAY] * 4)),
    ],
)
def test_gray_in_every_encoding_stays_gray(encoding: str, pixels: NDArray[Any]) -> None:
    image_bgr = images.decode_color(message(pixels, encoding)).astype(int)
    assert image_bgr.shape == (24, 32, 3)
    assert np.abs(image_bgr - GRAY[..., None])[2:-2, 2:-2].max() <= 6


@pytest.mark.parametrize(
    ('encoding', 'y', 'u', 'v'),
    [('yuv422', 1, 0, 2), ('uyvy', 1, 0, 2), ('yuv422_yuy2', 0, 1, 3), ('yuyv', 0, 1, 3)],
)
def test_packed_yuv_has_the_color_of_opencv(encoding: str, y: int, u: int, v: int) -> None:
    blue = np.full((8, 16, 3), (200, 40, 30), np.uint8)
    yuv = cv2.cvtColor(blue, cv2.COLOR_BGR2YUV)[0, 0]
    pairs = np.zeros((8, 8, 4), np.uint8)
    pairs[..., [y, y + 2]], pairs[..., u], pairs[..., v] = yuv[0], yuv[1], yuv[2]
    image_bgr = images.decode_color(message(pairs.reshape(8, 16, 2), encoding)).astype(int)
    assert np.abs(image_bgr - blue).max() < 25  # studio swing


def test_nv12_has_half_as_many_rows_of_chroma() -> None:
    planes = np.full((12, 16), 128, np.uint8)
    image = replace(message(planes, 'nv12'), height=8)
    assert images.decode_color(image).shape == (8, 16, 3)


@pytest.mark.parametrize(
    ('encoding', 'values'),
    [
        ('16SC1', np.array([[1500, -3, 0]], np.int16)),
        ('64FC1', np.array([[1.5, np.nan, -1.0]], np.float64)),
        ('16UC1', np.array([[1500, 0, 0]], np.uint16)),
    ],
)
def test_depth_in_every_encoding_is_in_meters(encoding: str, values: NDArray[Any]) -> None:
    assert images.decode_depth(message(values, encoding)).tolist() == [[1.5, 0, 0]]


def test_float_depth_in_millimeters_is_refused() -> None:
    depth_mm = np.full((480, 640), 1500, np.float32)
    with pytest.raises(MessageError, match='median of 1500 m, so its unit is wrong: it is 32FC1'):
        images.decode_depth(message(depth_mm, '32FC1'))
    assert images.decode_depth(message(depth_mm / 1000, '32FC1')).max() == 1.5


def test_a_depth_png_without_header_is_decoded() -> None:
    png = cv2.imencode('.png', np.array([[1500, 0]], np.uint16))[1].tobytes()
    depth_m = compressed_images.decode_compressed_depth('16UC1; png compressed ', png)
    assert depth_m.tolist() == [[1.5, 0]]


def test_color_encodings_are_no_depth() -> None:
    with pytest.raises(MessageError, match='use 16UC1'):
        images.decode_depth(message(COLOR, 'bgr8'))


@given(arrays(np.uint16, (4, 5)))
def test_compressed_depth_is_lossless(depth_mm: NDArray[np.uint16]) -> None:
    data = images.encode_compressed_depth(depth_mm)
    depth_m = compressed_images.decode_compressed_depth(images.COMPRESSED_DEPTH_FORMAT, data)
    expected_mm = np.where(depth_mm >= MIN_DEPTH_M * 1000, depth_mm, 0)
    np.testing.assert_array_equal(images.depth_mm_or_none(depth_m), expected_mm)


def test_quantized_inverse_depth_is_decoded() -> None:
    # What compressed_depth_image_transport writes for 32FC1: A / depth + B, rounded.
    quant_a, quant_b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    truth = np.array([[1.0, 2.0, 5.0]])
    png = cv2.imencode(
        '.png', np.append(np.rint(quant_a / truth + quant_b), 0)[None].astype(np.uint16)
    )[1]
    data = images.COMPRESSED_DEPTH_HEADER.pack(0, quant_a, quant_b) + png.tobytes()
    depth_m = compressed_images.decode_compressed_depth('32FC1; compressedDepth png', data)
    np.testing.assert_allclose(depth_m, [[1, 2, 5, 0]], rtol=2e-3)


@pytest.mark.parametrize(
    ('format_', 'data', 'expected'),
    [
        ('16UC1; compressedDepth rvl', b'x' * 20, 'RVL image claims to be'),
        ('jpeg', b'x' * 20, '"jpeg"'),
        ('16UC1; compressedDepth png', b'x' * 12, '12 bytes, too few'),
        ('16UC1; compressedDepth png', b'x' * 40, '28 bytes is not a readable'),
        (
            '16UC1; compressedDepth png',
            bytes(12) + cv2.imencode('.png', COLOR)[1].tobytes(),
            'not one channel of 16 bits',
        ),
    ],
)
def test_errors_name_bad_compressed_depth(format_: str, data: bytes, expected: str) -> None:
    with pytest.raises(MessageError, match=expected):
        compressed_images.decode_compressed_depth(format_, data)


def test_jpeg_round_trip_is_close() -> None:
    picture = np.full((16, 16, 3), (50, 100, 150), np.uint8)
    decoded = compressed_images.decode_compressed_color(images.encode_jpeg(picture, 95))
    assert np.abs(decoded.astype(int) - picture).max() <= 2


def test_an_empty_jpeg_is_an_error() -> None:
    with pytest.raises(MessageError, match='compressed color image of 0 bytes'):
        compressed_images.decode_compressed_color(b'')


def png_said_to_be_of(side_px: int, pixels: NDArray[Any]) -> bytes:
    """Return a PNG whose header claims another size."""
    png = cv2.imencode('.png', pixels)[1].tobytes()
    header = b'IHDR' + struct.pack('>II', side_px, side_px) + png[24:29]
    return png[:12] + header + struct.pack('>I', zlib.crc32(header)) + png[33:]


def test_images_beyond_max_pixels_are_refused() -> None:
    expected = 'claims to be 60000x60000 px, more than 33 megapixels$'
    with pytest.raises(MessageError, match=rf'^compressed color image .* {expected}'):
        compressed_images.decode_compressed_color(png_said_to_be_of(60_000, COLOR))
    depth = bytes(12) + png_said_to_be_of(60_000, np.ones((2, 2), np.uint16))
    with pytest.raises(MessageError, match=rf'^compressed depth .* {expected}'):
        compressed_images.decode_compressed_depth(images.COMPRESSED_DEPTH_FORMAT, depth)


@given(st.integers(0, 65535))
def test_depth_in_whole_millimeters_is_converted_exactly(depth_mm: NDArray[np.uint16]) -> None:
    depth_m = np.full((1, 1), depth_mm, np.float32) / np.float32(1000)
    np.testing.assert_array_equal(images.depth_mm_or_none(depth_m), [[depth_mm]])


@pytest.mark.parametrize('depth_m', [1.0002, 70.0])
def test_other_depth_is_not_converted_to_millimeters(depth_m: float) -> None:
    assert images.depth_mm_or_none(np.full((1, 1), depth_m, np.float32)) is None


def test_an_image_without_pixels_cannot_be_encoded() -> None:
    with pytest.raises(MessageError, match=r'image of shape \(0, 4, 3\) has no pixels'):
        images.encode_jpeg(np.empty((0, 4, 3), np.uint8), 90)
    with pytest.raises(MessageError, match=r'depth image of shape \(4, 0\) has no pixels'):
        images.encode_compressed_depth(np.empty((4, 0), np.uint16))
