"""One channel of an OpenEXR image, which the wheels of OpenCV cannot read.

Format: https://openexr.com/en/latest/OpenEXRFileLayout.html, single-part scan lines.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np

from hoid_common.errors import InputError, replaced_by
from hoid_common.values import ByteArray, Float32Array

_MAGIC: Final = b'\x76\x2f\x31\x01'
_NOT_SCAN_LINES: Final = 0x1A00  # flags of the version: tiles, deep data, several parts
_LINES = {0: 1, 2: 1, 3: 16}  # scan lines of a block by compression: none, ZIPS, ZIP
_TYPES = {0: '<u4', 1: '<f2', 2: '<f4'}  # NumPy type by pixel type
_MAX_PIXELS = 50_000_000  # chosen: more than any depth camera has
_MAX_BLOCK_BYTES = 100_000_000  # chosen: 16 lines of 90,000 pixels in four channels
_DAMAGE = (struct.error, zlib.error, ValueError, LookupError, OverflowError, StopIteration)


def decode_exr(data: bytes, name: object) -> Float32Array:
    """Return the (H, W) values of channel R, or of the first one if there is no R.

    InputError (text begins with `name`): the data is damaged, or its compression unknown.
    """
    attributes, at = _header(data, name)
    problem = InputError(f'{name}: damaged EXR image')
    with replaced_by(problem, *_DAMAGE):
        width, height = _size_px(attributes, name)
        channels = _channels(attributes['channels'])
        compression = attributes['compression'][0]
        if compression not in _LINES:
            raise InputError(f'{name}: EXR compression {compression} is not known, only none, ZIP')
        chosen = 'R' if 'R' in channels else next(iter(channels))
        line_bytes = sum(width * np.dtype(kind).itemsize for kind in channels.values())
        lines = _LINES[compression]
        if lines * line_bytes > _MAX_BLOCK_BYTES:
            raise InputError(f'{name}: EXR image of {len(channels)} channels in {width} columns')
        line = np.dtype([(channel, kind, (width,)) for channel, kind in channels.items()])
        image = np.zeros((height, width), np.float32)
        first_row = struct.unpack_from('<i', attributes['dataWindow'], 4)[0]
        for offset in struct.unpack_from(f'<{-(-height // lines)}Q', data, at):
            row, size = struct.unpack_from('<iI', data, offset)
            block = data[offset + 8 : offset + 8 + size]
            count = min(lines, height - (row - first_row))
            if row < first_row or count < 1:
                raise ValueError('block outside of the image')
            rows = _unpacked(block, count * line_bytes).view(line)
            image[row - first_row : row - first_row + count] = rows[chosen]
        return image


def _unpacked(block: bytes, size: int) -> ByteArray:
    """Return the bytes of a block, which is stored as it is if ZIP does not make it smaller."""
    if len(block) == size:
        return np.frombuffer(block, np.uint8)
    packed = np.frombuffer(zlib.decompressobj().decompress(block, size), np.uint8).copy()
    # ZIP stores differences of neighboring bytes: all even bytes first, then all odd bytes.
    packed[1:] -= np.uint8(128)
    values = np.cumsum(packed, dtype=np.uint8)
    found = np.empty(size, np.uint8)
    found[0::2], found[1::2] = np.split(values, [(size + 1) // 2])
    return found


def _header(data: bytes, name: object) -> tuple[dict[str, bytes], int]:
    """Return attributes by name, and the byte offset of the block table; InputError if invalid."""
    version = int.from_bytes(data[4:8], 'little')
    if data[:4] != _MAGIC or version & _NOT_SCAN_LINES:
        raise InputError(f'{name}: no EXR image of scan lines')
    attributes: dict[str, bytes] = {}
    at = 8
    while data[at : at + 1] != b'\0':
        key, _, rest = data[at : at + 1024].partition(b'\0')
        kind, found, _ = rest.partition(b'\0')
        at += len(key) + len(kind) + 2
        size = int.from_bytes(data[at : at + 4], 'little')
        if not found or at + 4 + size > len(data):
            raise InputError(f'{name}: damaged EXR image')
        attributes[key.decode('latin-1')] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _size_px(attributes: dict[str, bytes], name: object) -> tuple[int, int]:
    left, top, right, bottom = struct.unpack('<4i', attributes['dataWindow'])
    width, height = right - left + 1, bottom - top + 1
    if width <= 0 or height <= 0 or width * height > _MAX_PIXELS:
        raise InputError(f'{name}: EXR image of {width}x{height} px')
    return width, height


def _channels(data: bytes) -> dict[str, str]:
    """Return the data types of the channels by name, in the order in which lines have them."""
    found = {}
    while data[:1] not in (b'\0', b''):
        name, _, rest = data.partition(b'\0')
        found[name.decode('latin-1')] = _TYPES[struct.unpack_from('<i', rest)[0]]
        data = rest[16:]
    return found
