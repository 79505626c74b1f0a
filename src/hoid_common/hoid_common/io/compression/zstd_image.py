"""Decoding of the color and depth images that zstd_image_transport publishes."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

from backports.zstd import ZstdDecompressor, ZstdError

from hoid_common.errors import MessageError, replaced_by
from hoid_common.io.images import RawImage
from hoid_common.values import MAX_PIXELS

ZSTD_FORMAT = 'zstd'
_HEAD = struct.Struct('<IIBII')  # height, width, byte order, step, length of the encoding's name
_MAX_NAME = 50  # chosen: longer than the name of any encoding
_MAX_PIXEL_BYTES = 8
# The plugin of Jazzy and of earlier distributions compresses with zlib, in spite of its name.
_GZIP, _ANY_ZLIB = b'\x1f\x8b', 47


def stored_head(data: bytes) -> RawImage:
    """Return an image with its pixels still compressed; MessageError if its header is invalid."""
    if len(data) < _HEAD.size:
        raise MessageError(f'zstd image has {len(data)} bytes, too few for its header')
    height, width, is_bigendian, step, length = _HEAD.unpack_from(data)
    name = data[_HEAD.size : _HEAD.size + min(length, _MAX_NAME)]
    if not (0 < width * height <= MAX_PIXELS and step <= _MAX_PIXEL_BYTES * width):
        raise MessageError(f'zstd image claims to be {width}x{height} px at step {step}')
    if len(name) != length or not name.isascii():
        raise MessageError('zstd image has no encoding')
    packed = data[_HEAD.size + length :]
    return RawImage(height, width, name.decode(), is_bigendian, step, packed)


def stored_image(data: bytes) -> RawImage:
    head = stored_head(data)
    most = 3 * head.step * head.height  # NV24 has three times as many rows as the image
    problem = MessageError(f'zstd image of {len(data)} bytes cannot be unpacked')
    with replaced_by(problem, zlib.error, ZstdError, EOFError):
        if head.data[:2] == _GZIP or head.data[:1] == b'\x78':
            pixels = zlib.decompressobj(_ANY_ZLIB).decompress(head.data, most)
        else:
            pixels = ZstdDecompressor().decompress(head.data, most)
    return replace(head, data=pixels)
