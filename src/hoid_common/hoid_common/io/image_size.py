"""What a PNG or JPEG would cost, told from its headers before anything is decoded."""

from __future__ import annotations

import struct
from typing import Final

from hoid_common.errors import MessageError
from hoid_common.values import MAX_PIXELS

_PNG_START: Final = b'\x89PNG\r\n\x1a\n'
_PNG_CHUNK = struct.Struct('>I4s')  # length, name; four bytes of checksum follow the content
_PNG_PACKED: Final = (b'zTXt', b'iTXt', b'iCCP')
_MAX_CHUNKS, _MAX_PACKED = 100_000, 8
_PNG_SIZE = struct.Struct('>4x4sII')  # of the first chunk: length, name, width, height
_JPEG_START: Final = b'\xff\xd8'
_JPEG_SCAN: Final = b'\xff\xda'
_MAX_SCANS = 100  # progressive ones have ten; each costs as much as the image is large
_JPEG_SEGMENT = struct.Struct('>BBH')  # 0xff, marker, length with its own two bytes
_JPEG_SIZE = struct.Struct('>xHH')  # of a frame header: precision, height, width
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE: Final = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length


def image_size_px(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return width, height that the header of a PNG or JPEG says; None where it is neither."""
    try:
        if data[: len(_PNG_START)] == _PNG_START:
            name, width, height = _PNG_SIZE.unpack_from(data, len(_PNG_START))
            return (width, height) if name == b'IHDR' else None
        return _jpeg_size(data) if data[: len(_JPEG_START)] == _JPEG_START else None
    except struct.error:  # it ends before
        return None


def is_sound(data: bytes | memoryview) -> bool:
    """Return whether decoding a PNG or JPEG takes what its size lets expect.

    A PNG's chunks end within it, as decoders make room for what a chunk says to hold, and few of
    them hold packed text. A JPEG has few scans.
    """
    if data[: len(_PNG_START)] != _PNG_START:
        return bytes(data).count(_JPEG_SCAN) <= _MAX_SCANS
    at, num_packed = len(_PNG_START), 0
    for _ in range(_MAX_CHUNKS):
        if at + _PNG_CHUNK.size > len(data):
            return False
        size, name = _PNG_CHUNK.unpack_from(data, at)
        at += _PNG_CHUNK.size + size + 4
        num_packed += name in _PNG_PACKED
        if name == b'IEND':
            return at <= len(data) and num_packed <= _MAX_PACKED
    return False


def check_image_size(data: bytes | memoryview, what: str) -> None:
    """Raise MessageError for what is no PNG or JPEG, or has more than MAX_PIXELS.

    Args:
        data: The compressed image.
        what: It is, for the error.
    """
    size = image_size_px(data)
    if size is None:
        raise MessageError(f'{what} of {len(data)} bytes is not a readable JPEG or PNG')
    if size[0] * size[1] > MAX_PIXELS:
        raise MessageError(
            f'{what} of {len(data)} bytes says to be {size[0]}x{size[1]} px, '
            f'more than {MAX_PIXELS / 1e6:.0f} megapixels'
        )


def _jpeg_size(data: bytes | memoryview) -> tuple[int, int] | None:
    at = len(_JPEG_START)
    while True:
        start, marker, length = _JPEG_SEGMENT.unpack_from(data, at)
        if start != 0xFF:
            return None
        if marker == 0xFF or marker in _JPEG_ALONE:  # filling, or nothing within
            at += 1 if marker == 0xFF else 2
        elif marker in _JPEG_FRAMES:
            height, width = _JPEG_SIZE.unpack_from(data, at + _JPEG_SEGMENT.size)
            return width, height
        else:
            at += 2 + length
