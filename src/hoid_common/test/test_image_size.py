"""The size in an image's header, and what is refused for it."""

import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.errors import MessageError
from hoid_common.io.image_size import check_image_size, image_size_px, is_sound
from hoid_common.io.images import decode_compressed_color, decode_compressed_depth
from hoid_common.values import MAX_PIXELS


def encoded(ending: str, width: int, height: int) -> bytes:
    picture = np.full((height, width, 3), 90, np.uint8)
    data: bytes = cv2.imencode(ending, picture)[1].tobytes()
    return data


def png_bomb(width: int, height: int) -> bytes:
    """A whole PNG of black 16-bit pixels, some thousand times smaller than they are."""

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
def test_the_header_says_what_decoding_gives(ending: str, size: tuple[int, int]) -> None:
    assert image_size_px(encoded(ending, *size)) == size


def test_segments_before_the_frame_are_passed_over() -> None:
    jpeg = encoded('.jpg', 40, 30)
    comment = b'\xff\xfe' + struct.pack('>H', 7) + b'hello'
    assert image_size_px(jpeg[:2] + comment + b'\xff' + jpeg[2:]) == (40, 30)


@given(st.binary(max_size=200), st.sampled_from([b'', b'\x89PNG\r\n\x1a\n', b'\xff\xd8\xff']))
def test_no_bytes_are_too_strange(data: bytes, start: bytes) -> None:
    size = image_size_px(start + data)
    assert size is None or min(size) >= 0


@given(st.integers(0, 600), st.sampled_from(['.png', '.jpg']))
def test_a_header_that_is_cut_is_no_header(length: int, ending: str) -> None:
    assert image_size_px(encoded(ending, 640, 480)[:length]) in (None, (640, 480))


def test_a_bomb_is_refused_before_it_is_unpacked() -> None:
    bomb = png_bomb(8000, 5000)
    assert len(bomb) < 200_000
    tracemalloc.start()
    with pytest.raises(MessageError, match='says to be 8000x5000 px, more than 33 megapixels'):
        decode_compressed_color(bomb)
    with pytest.raises(MessageError, match=r'compressed depth .* says to be 8000x5000 px'):
        decode_compressed_depth('16UC1; compressedDepth png', bytes(12) + bomb)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_an_image_of_the_largest_size_passes() -> None:
    check_image_size(b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR' + struct.pack('>II', 7680, 4320), 'image')
    assert MAX_PIXELS == 7680 * 4320


def chunk(name: bytes, content: bytes, says: int | None = None) -> bytes:
    """Return a chunk of a PNG, which may say to be of another length."""
    checksum = struct.pack('>I', zlib.crc32(name + content))
    return struct.pack('>I', len(content) if says is None else says) + name + content + checksum


def after_header(png: bytes, more: bytes) -> bytes:
    """Return a PNG with more chunks behind its header."""
    return png[:33] + more + png[33:]


def test_what_encoders_write_is_sound() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    assert is_sound(cv2.imencode('.jpg', noise)[1].tobytes())
    assert is_sound(cv2.imencode('.jpg', noise, options)[1].tobytes())
    png = cv2.imencode('.png', noise)[1].tobytes()
    assert is_sound(png)
    assert is_sound(after_header(png, chunk(b'iCCP', b'a profile')))


@pytest.mark.parametrize('says', [1_000_000, 2**31 - 1, 2**32 - 1])
def test_a_chunk_that_says_to_be_long_gets_no_memory(says: int) -> None:
    png = after_header(encoded('.png', 64, 48), chunk(b'IDAT', b'', says))
    with pytest.raises(MessageError, match='is not a readable JPEG or PNG'):
        decode_compressed_color(png)


def test_packed_text_is_not_unpacked() -> None:
    bomb = chunk(b'zTXt', b'x\0\0' + zlib.compress(bytes(1_000_000))) * 20
    assert not is_sound(after_header(encoded('.png', 64, 48), bomb))


def test_a_jpeg_of_many_scans_is_refused() -> None:
    jpeg = encoded('.jpg', 64, 48)
    scan = jpeg.index(b'\xff\xda')
    with pytest.raises(MessageError, match='is not a readable JPEG or PNG'):
        decode_compressed_color(jpeg[:scan] + jpeg[scan:-2] * 200 + jpeg[-2:])


@pytest.mark.parametrize('turned', range(1, 9))
def test_colour_does_not_turn_with_what_its_file_says(turned: int) -> None:
    jpeg = encoded('.jpg', 64, 48)
    exif = b'Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01' + struct.pack(
        '>HHI', turned, 0, 0
    )
    said = b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif
    assert decode_compressed_color(jpeg[:2] + said + jpeg[2:]).shape == (48, 64, 3)
