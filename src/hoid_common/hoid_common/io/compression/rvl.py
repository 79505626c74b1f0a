"""Decoding of RVL, a lossless compression of depth images (Wilson 2017), as in image_transport."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.values import MAX_PIXELS

_SIZE = struct.Struct('<II')  # width, height
# Each 4-bit group: flag that another group of the same number follows, and number of value bits.
_MORE, _BITS = 8, 3


def rvl_size_px(data: bytes) -> tuple[int, int]:
    """Return width and height of an RVL image; MessageError if they are missing or invalid."""
    if len(data) < _SIZE.size:
        raise MessageError(f'RVL image has {len(data)} bytes, too few for its size')
    width, height = _SIZE.unpack_from(data)
    if not 0 < width * height <= MAX_PIXELS:
        raise MessageError(f'RVL image claims to be {width}x{height} px')
    return width, height


def decode_rvl(data: bytes) -> NDArray[np.uint16]:
    """Return the (H, W) uint16 pixels of an RVL image; MessageError if it is invalid.

    Runs of zeros and runs of non-zero pixels alternate. A non-zero pixel is stored as its
    difference from the previous non-zero pixel.
    """
    width, height = rvl_size_px(data)
    values = _numbers(data[_SIZE.size :])
    num_pixels = width * height
    pixels, steps, places = np.zeros(num_pixels, np.uint16), [], []
    at = pixel = 0
    while pixel < num_pixels:
        if at + 2 > len(values):
            raise MessageError(f'RVL image of {width}x{height} px ends after {pixel} pixels')
        zeros, count = values[at : at + 2].tolist()
        pixel, at = pixel + zeros, at + 2
        if pixel + count > num_pixels or at + count > len(values) or zeros + count == 0:
            raise MessageError(f'RVL image of {width}x{height} px is damaged at pixel {pixel}')
        steps.append(values[at : at + count])
        places.append(np.arange(pixel, pixel + count))
        pixel, at = pixel + count, at + count
    step = np.concatenate(steps)
    pixels[np.concatenate(places)] = np.cumsum((step >> 1) ^ -(step & 1)) & 0xFFFF
    return pixels.reshape(height, width)


def _numbers(data: bytes) -> NDArray[np.int64]:
    """Return the numbers in data; each has one or more 4-bit groups, the highest bits first."""
    words = np.frombuffer(data[: len(data) // 4 * 4], '<u4').astype('>u4').view(np.uint8)
    groups = np.stack([words >> 4, words & 0xF], axis=1).ravel()
    ends = np.flatnonzero(groups < _MORE)
    starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    if len(ends) == 0 or (ends - starts).max() > 10:  # more than 32 bits
        raise MessageError('RVL image is damaged')
    place = np.arange(ends[-1] + 1) - np.repeat(starts, ends - starts + 1)
    bits = (groups[: ends[-1] + 1] & (_MORE - 1)).astype(np.int64) << (_BITS * place)
    return np.add.reduceat(bits, starts)
