"""Size and decoding cost of a PNG, JPEG or TIFF, read from its headers without decoding it.

OpenCV allocates the memory that a header demands: check it first against decompression bombs.
"""

from __future__ import annotations

import struct
from typing import Final

from hoid_common.errors import MessageError
from hoid_common.values import MAX_PIXELS

_PNG_START: Final = b'\x89PNG\r\n\x1a\n'
_PNG_CHUNK = struct.Struct('>I4s')  # length, name; a checksum of 4 bytes follows the content
_PNG_COMPRESSED_TEXT: Final = (b'zTXt', b'iTXt', b'iCCP')
# Chosen: a PNG with more chunks, or with more compressed texts, is refused. libpng writes an image
# as chunks of 8 kB, so that 8K images have about 12,000. Each compressed text may expand to 8 MB
# (libpng's limit); cameras write none.
_MAX_CHUNKS, _MAX_COMPRESSED_TEXTS = 100_000, 8
_PNG_SIZE = struct.Struct('>4x4sII')  # first chunk: length, name, width, height
_TIFF_LITTLE: Final = b'II*\0'
_TIFF_BIG: Final = b'MM\0*'
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_SHORT = 256, 257, 3  # tags, and the type of 16-bit numbers
_JPEG_START: Final = b'\xff\xd8\xff'  # the last byte begins the first segment
_JPEG_SCAN: Final = b'\xff\xda'
# Chosen: a JPEG with more scans is refused. Progressive JPEGs have about ten. Decoding each scan
# takes time in proportion to the image size, however short the scan is.
_MAX_SCANS = 100
_JPEG_SEGMENT = struct.Struct('>BBH')  # 0xff, marker, length including its own two bytes
_JPEG_SIZE = struct.Struct('>xHH')  # frame header: precision, height, width
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF markers (T.81)
_JPEG_WITHOUT_LENGTH: Final = frozenset({0x01, *range(0xD0, 0xD8)})  # TEM and RST markers


def is_png(data: bytes | memoryview) -> bool:
    return data[: len(_PNG_START)] == _PNG_START


def is_jpeg(data: bytes | memoryview) -> bool:
    return data[: len(_JPEG_START)] == _JPEG_START


def image_size_px(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return (width, height) from the header of a PNG, JPEG or TIFF, or None."""
    try:
        if data[: len(_TIFF_LITTLE)] in (_TIFF_LITTLE, _TIFF_BIG):
            return _tiff_size(data)
        if is_png(data):
            name, width, height = _PNG_SIZE.unpack_from(data, len(_PNG_START))
            return (width, height) if name == b'IHDR' else None
        return _jpeg_size(data) if is_jpeg(data) else None
    except struct.error:  # the data ends within the header
        return None


def is_safe_to_decode(data: bytes | memoryview) -> bool:
    """Return whether decoding takes no longer than the size suggests, and a PNG is complete."""
    if not is_png(data):
        return bytes(data).count(_JPEG_SCAN) <= _MAX_SCANS
    at, num_compressed = len(_PNG_START), 0
    for _ in range(_MAX_CHUNKS):
        if at + _PNG_CHUNK.size > len(data):
            return False
        size, name = _PNG_CHUNK.unpack_from(data, at)
        at += _PNG_CHUNK.size + size + 4
        if name in _PNG_COMPRESSED_TEXT:
            num_compressed += 1
        if name == b'IEND':
            return at <= len(data) and num_compressed <= _MAX_COMPRESSED_TEXTS
    return False


def check_image_size(data: bytes | memoryview, what: str) -> None:
    """Raise MessageError if the header of an image is invalid, or claims more than MAX_PIXELS."""
    size = image_size_px(data)
    if size is None:
        raise MessageError(f'{what} of {len(data)} bytes is not a readable JPEG, PNG or TIFF')
    if size[0] * size[1] > MAX_PIXELS:
        raise MessageError(
            f'{what} of {len(data)} bytes claims to be {size[0]}x{size[1]} px, '
            f'more than {MAX_PIXELS / 1e6:.0f} megapixels'
        )


def _tiff_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return (width, height) of a TIFF, or None if missing; struct.error if data ends early."""
    order = '<' if data[: len(_TIFF_LITTLE)] == _TIFF_LITTLE else '>'
    (at,) = struct.unpack_from(f'{order}I', data, len(_TIFF_LITTLE))
    (count,) = struct.unpack_from(f'{order}H', data, at)
    sides: dict[int, int] = {}
    for i in range(count):
        place = at + 2 + 12 * i
        tag, kind = struct.unpack_from(f'{order}HH', data, place)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            code = 'H' if kind == _TIFF_SHORT else 'I'
            (sides[tag],) = struct.unpack_from(f'{order}{code}', data, place + 8)
    size = sides.get(_TIFF_WIDTH, 0), sides.get(_TIFF_HEIGHT, 0)
    return size if all(size) else None


def _jpeg_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return (width, height) from the frame header, or None; struct.error if data ends early."""
    at = len(_JPEG_START) - 1
    while True:
        start, marker, length = _JPEG_SEGMENT.unpack_from(data, at)
        if start != 0xFF:
            return None
        if marker == 0xFF or marker in _JPEG_WITHOUT_LENGTH:  # 0xff is a fill byte
            at += 1 if marker == 0xFF else 2
        elif marker in _JPEG_FRAMES:
            height, width = _JPEG_SIZE.unpack_from(data, at + _JPEG_SEGMENT.size)
            return width, height
        else:
            at += 2 + length
