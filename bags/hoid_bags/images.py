"""Image files of recordings, decoded once they are known to be whole and of the right kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import InputError
from hoid_common.io.image_size import image_size_px, is_safe_to_decode
from hoid_common.io.images import COLOR_READ_FLAGS
from hoid_common.io.untrusted import read_bytes
from hoid_common.values import MAX_PIXELS, ByteArray, CameraModel, Float32Array

DepthUnits = NDArray[np.uint16]

_MAX_FILE_BYTES = 256_000_000

_PNG_START, _PNG_END = b'\x89PNG\r\n\x1a\n', b'IEND\xaeB`\x82'
_JPEG_START, _JPEG_END = b'\xff\xd8\xff', b'\xff\xd9'


def read_image_bytes(path: Path) -> bytes:
    """Return the content of an image file.

    Raises:
        InputError: the file cannot be read, is no regular one or larger than any image.
    """
    return read_bytes(path, _MAX_FILE_BYTES)


def is_png(data: bytes) -> bool:
    """Return whether bytes begin as a PNG does."""
    return data.startswith(_PNG_START)


def is_jpeg(data: bytes) -> bool:
    """Return whether bytes begin as a JPEG does."""
    return data.startswith(_JPEG_START)


def check_whole(data: bytes, name: object) -> None:
    """Raise InputError when a PNG or JPEG lacks its end.

    Looked for before decoding: some decoders fill the missing part with grey and say nothing,
    others write to the terminal.
    """
    truncated = (is_png(data) and _PNG_END not in data[-64:]) or (
        is_jpeg(data) and _JPEG_END not in data[-1024:]
    )
    if truncated or not data:
        raise InputError(f'{name}: truncated image ({len(data)} bytes); fetch the file again')


def decode_color(data: bytes, name: object) -> ByteArray:
    """Return (H, W, 3) uint8, order BGR, of a PNG or JPEG.

    Raises:
        InputError: truncated, or no image.
    """
    return cast('ByteArray', _decode(data, COLOR_READ_FLAGS, name))


def decode_depth(data: bytes, name: object) -> DepthUnits:
    """Return (H, W) uint16 of a 16-bit grey PNG.

    Raises:
        InputError: truncated, no image, or of another kind.
    """
    image = _decode(data, cv2.IMREAD_UNCHANGED, name)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise InputError(
            f'{name}: depth must be 16-bit grey,'
            f' got {image.dtype.itemsize * 8}-bit with {channels} channel(s)'
        )
    return cast('DepthUnits', image)


def check_size(
    image: ByteArray | DepthUnits | Float32Array, camera: CameraModel, name: object
) -> None:
    """Raise InputError unless an image has the camera's size."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise InputError(
            f'{name}: image is {width}x{height}, the camera {camera.width_px}x{camera.height_px};'
            ' give the camera of this recording with --camera'
        )


def depth_m_from_units(depth: DepthUnits, units_per_m: float) -> Float32Array:
    """Return metres, the float32 nearest to value / units."""
    return np.divide(depth, np.float32(units_per_m), dtype=np.float32)


def _decode(data: bytes, flags: int, name: object) -> NDArray[Any]:
    check_whole(data, name)
    size = image_size_px(data)
    if size is not None and size[0] * size[1] > MAX_PIXELS:
        raise InputError(f'{name}: says to be {size[0]}x{size[1]} px, more than any camera gives')
    try:
        readable = size is not None and is_safe_to_decode(data)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if readable else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f'{name}: not an image that can be decoded')
    return cast('NDArray[Any]', image)
