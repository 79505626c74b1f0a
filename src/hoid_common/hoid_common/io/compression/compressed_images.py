"""Decoding of sensor_msgs/CompressedImage, color or depth, by any plugin of image_transport."""

from __future__ import annotations

from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.io import images
from hoid_common.io.compression.rvl import decode_rvl, rvl_size_px
from hoid_common.io.compression.zstd_image import ZSTD_FORMAT, stored_head, stored_image
from hoid_common.io.image_size import check_image_size, image_size_px, is_safe_to_decode
from hoid_common.io.images import COMPRESSED_DEPTH_HEADER, DEPTH_ENCODINGS, Buffer
from hoid_common.values import ByteArray, Float32Array

COLOR_READ_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
"""OpenCV's flags for color images. An EXIF orientation is ignored, since depth has none."""
_DEPTH_KEYWORD, _RVL = 'compressedDepth', 'compressedDepth rvl'


def compressed_head(format_: str, data: Buffer) -> tuple[str, tuple[int, int] | None]:
    """Return encoding, and (width, height) or None, of a compressed image, without decoding it.

    Depth images, and only these, have one of the depth encodings. MessageError if `format` and
    `data` contradict.
    """
    raw = bytes(data)
    if format_ == ZSTD_FORMAT:
        stored = stored_head(raw)
        return stored.encoding, (stored.width, stored.height)
    encoding = format_.partition(';')[0].strip()
    if _DEPTH_KEYWORD not in format_:
        return encoding, image_size_px(raw)
    payload = raw[COMPRESSED_DEPTH_HEADER.size :]
    size_px = rvl_size_px(payload) if _RVL in format_ else image_size_px(payload)
    return encoding if encoding in DEPTH_ENCODINGS else DEPTH_ENCODINGS[0], size_px


def decode_compressed_color(data: Buffer, format_: str = '') -> ByteArray:
    """Return the (H, W, 3) uint8 BGR image of `data` in a `format`; MessageError if unreadable."""
    if format_ == ZSTD_FORMAT:
        return images.decode_color(stored_image(bytes(data)))
    what = f'compressed color image of format "{format_}"' if format_ else 'compressed color image'
    return cast('ByteArray', decode_image(data, COLOR_READ_FLAGS, what))


def decode_compressed_depth(format_: str, data: Buffer, units_per_m: float = 0.0) -> Float32Array:
    """Return the (H, W) float32 depth in m of a compressed depth image; 0 = no depth.

    In compressedDepth, a header of 12 bytes comes before 16-bit depth in mm (16UC1) or quantized
    inverse depth (32FC1). MessageError if format, data or unit is invalid.
    """
    if format_ == ZSTD_FORMAT:
        return images.decode_depth(stored_image(bytes(data)), units_per_m)
    encoding = format_.partition(';')[0].strip()
    if encoding not in ('16UC1', '32FC1'):
        raise MessageError(
            f'compressed depth has format "{format_}"; use "16UC1; compressedDepth png" or 32FC1'
        )
    raw = bytes(data)
    has_header = image_size_px(raw) is None  # compressed_image_transport writes none
    if has_header and len(raw) <= COMPRESSED_DEPTH_HEADER.size:
        raise MessageError(f'compressed depth has {len(raw)} bytes, too few for its header')
    payload = raw[COMPRESSED_DEPTH_HEADER.size :] if has_header else raw
    pixels = decode_rvl(payload) if _RVL in format_ else _one_channel(payload, format_)
    if pixels.dtype == np.float32 or encoding == '16UC1' or not has_header:
        kind = '32FC1' if pixels.dtype == np.float32 else '16UC1'
        return images.depth_in_m(pixels, kind, units_per_m)
    _, quant_a, quant_b = COMPRESSED_DEPTH_HEADER.unpack_from(raw)
    with np.errstate(divide='ignore', invalid='ignore'):
        depth_m = quant_a / (pixels.astype(np.float32) - np.float32(quant_b))
    depth_m = np.where(pixels == 0, np.float32(0), depth_m.astype(np.float32))
    return images.depth_in_m(depth_m, encoding, units_per_m)


def _one_channel(data: bytes, format_: str) -> NDArray[Any]:
    """Return the (H, W) uint16 or float32 pixels of a PNG or TIFF."""
    what = f'compressed depth of format "{format_}"'
    pixels = decode_image(data, cv2.IMREAD_UNCHANGED, what)
    if pixels.dtype not in (np.uint16, np.float32) or pixels.ndim != 2:
        raise MessageError(
            f'{what} has {pixels.dtype} pixels of shape {pixels.shape}, not one channel of 16 '
            'bits or float32'
        )
    return pixels


def decode_image(data: Buffer, flags: int, what: str) -> NDArray[Any]:
    """Return a decoded JPEG, PNG or TIFF; MessageError if it is invalid or costly to decode."""
    raw = np.frombuffer(data, np.uint8)
    check_image_size(raw.data, what)
    try:
        pixels = cv2.imdecode(raw, flags) if is_safe_to_decode(raw.data) else None
    except cv2.error as error:  # such as for more pixels than OpenCV's own limit
        reason = ' '.join(error.err.split())
        raise MessageError(f'{what} of {len(raw)} bytes cannot be decoded: {reason}') from error
    if pixels is None:
        raise MessageError(f'{what} of {len(raw)} bytes is not a readable JPEG, PNG or TIFF')
    return pixels
