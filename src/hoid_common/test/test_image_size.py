"""Image sizes from headers, and images that are refused because of them."""

import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.errors import MessageError
from hoid_common.io.compression.compressed_images import (
    decode_compressed_color,
    decode_compressed_depth,
)
from hoid_common.io.image_size import check_image_size, image_size_px, is_safe_to_decode
from hoid_common.values import MAX_PIXELS


def encoded(ending: str, width: int, height: int) -> bytes:
    picture = np.full((height, width, 3), 90, np.uint8)
    data: bytes = cv2.imencode(ending, picture)[1].tobytes()
    return data


def png_bomb(width: int, height: int) -> bytes:
    """Return a PNG of black 16-bit pixels, a thousandth of their size."""

    def chunk(name: bytes, content: bytes) -> bytes:
        checksum = zlib.crc32(name + content)
        return struct.pack('>I', len(content)) + name + content + struct.pack('>I', checksum)

    packer = zlib.compressobj(9)
    row = bytes(1 + 2 * width)
    rows = b''.join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack('>IIBBBBB', width, height, 16, 0, 0, 0, 0)
    start = b'\x89PNG\r\n\x1a\n'
    return start + chunk(b'IHDR', head) + chunk(b'IDAT', rows) + chunk(b'IEND', b'')


@pytest.mark.parametrize('ending', ['.png', '.jpg'])
@pytest.mark.parametrize('size', [(1, 1), (640, 480), (31, 1200)])
def test_size_in_the_header_equals_the_decoded_size(ending: str, size: tuple[int, int]) -> None:
    assert image_size_px(encoded(ending, *size)) == size


def test_segments_before_the_frame_header_are_skipped() -> None:
    jpeg = encoded('.jpg', 40, 30)
    comment = b'\xff\xfe' + struct.pack('>H', 7) + b'hello'
    assert image_size_px(jpeg[:2] + comment + b'\xff' + jpeg[2:]) == (40, 30)


@given(st.binary(max_size=200), st.sampled_from([b'', b'\x89PNG\r\n\x1a\n', b'\xff\xd8\xff']))
def test_random_bytes_raise_no_other_error(data: bytes, start: bytes) -> None:
    size = image_size_px(start + data)
    assert size is None or min(size) >= 0


@given(st.integers(0, 600), st.sampled_from(['.png', '.jpg']))
def test_a_truncated_header_gives_no_size(length: int, ending: str) -> None:
    assert image_size_px(encoded(ending, 640, 480)[:length]) in (None, (640, 480))


def test_a_decompression_bomb_is_refused_before_decoding() -> None:
    bomb = png_bomb(8000, 5000)
    assert len(bomb) < 200_000
    tracemalloc.start()
    with pytest.raises(MessageError, match='claims to be 8000x5000 px, more than 33 megapixels'):
        decode_compressed_color(bomb)
    with pytest.raises(MessageError, match=r'compressed depth .* claims to be 8000x5000 px'):
        decode_compressed_depth('16UC1; compressedDepth png', bytes(12) + bomb)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_an_image_of_the_largest_size_is_accepted() -> None:
    check_image_size(b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR' + struct.pack('>II', 7680, 4320), 'image')
    assert MAX_PIXELS == 7680 * 4320


def chunk(name: bytes, content: bytes, says: int | None = None) -> bytes:
    """Return a chunk of a PNG, which may claim another length."""
    checksum = struct.pack('>I', zlib.crc32(name + content))
    return struct.pack('>I', len(content) if says is None else says) + name + content + checksum


def after_header(png: bytes, more: bytes) -> bytes:
    """Return a PNG with additional chunks after its header."""
    return png[:33] + more + png[33:]


def test_images_of_usual_encoders_are_safe_to_decode() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    assert is_safe_to_decode(cv2.imencode('.jpg', noise)[1].tobytes())
    assert is_safe_to_decode(cv2.imencode('.jpg', noise, options)[1].tobytes())
    png = cv2.imencode('.png', noise)[1].tobytes()
    assert is_safe_to_decode(png)
    assert is_safe_to_decode(after_header(png, chunk(b'iCCP', b'a profile')))


@pytest.mark.parametrize('says', [1_000_000, 2**31 - 1, 2**32 - 1])
def test_a_chunk_with_a_false_length_is_refused(says: int) -> None:
    png = after_header(encoded('.png', 64, 48), chunk(b'IDAT', b'', says))
    with pytest.raises(MessageError, match='is not a readable JPEG, PNG or TIFF'):
        decode_compressed_color(png)


def test_many_compressed_texts_are_refused() -> None:
    bomb = chunk(b'zTXt', b'x\0\0' + zlib.compress(bytes(1_000_000))) * 20
    assert not is_safe_to_decode(after_header(encoded('.png', 64, 48), bomb))


def test_a_jpeg_of_many_scans_is_refused() -> None:
    jpeg = encoded('.jpg', 64, 48)
    scan = jpeg.index(b'\xff\xda')
    with pytest.raises(MessageError, match='is not a readable JPEG, PNG or TIFF'):
        decode_compressed_color(jpeg[:scan] + jpeg[scan:-2] * 200 + jpeg[-2:])


@pytest.mark.parametrize('turned', range(1, 9))
def test_exif_orientation_is_ignored(turned: int) -> None:
    jpeg = encoded('.jpg', 64, 48)
    exif = b'Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01' + struct.pack(
        '>HHI', turned, 0, 0
    )
    message = b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif
    assert decode_compressed_color(jpeg[:2] + message + jpeg[2:]).shape == (48, 64, 3)
