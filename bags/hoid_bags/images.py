"""Decodes a recording's image files, and checks that they are complete and of the right kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import InputError, MessageError, prefixed
from hoid_common.io.compression.compressed_images import COLOR_READ_FLAGS, decode_image
from hoid_common.io.image_size import is_jpeg, is_png
from hoid_common.io.untrusted import read_bytes
from hoid_common.values import ByteArray, CameraModel

ImageData = bytes | NDArray[Any]
"""An image as a file stores it, or its pixels."""

_MAX_FILE_BYTES = 256_000_000  # chosen: over twice the largest image, which has 100 MB as BGR

# Last bytes of both formats (PNG specification, 5.2; ITU-T T.81, B.1.1.3).
_PNG_END, _JPEG_END = b'IEND\xaeB`\x82', b'\xff\xd9'
# Largest number of bytes after the end, where programs append some. Chosen: a few for PNG, a block
# of metadata for JPEG.
_PNG_TAIL_BYTES, _JPEG_TAIL_BYTES = 64, 1024


def read_image_bytes(path: Path) -> bytes:
    """Return the content of a regular file of at most 256 MB; else InputError."""
    return read_bytes(path, _MAX_FILE_BYTES)


def check_complete(data: bytes, name: object) -> None:
    """Raise InputError if the data is empty, or a PNG or JPEG that is truncated.

    Data of another format raises no error. Decoders do not report truncation reliably:
    some fill the missing part with gray, and others write to the terminal.
    """
    truncated = (is_png(data) and _PNG_END not in data[-_PNG_TAIL_BYTES:]) or (
        is_jpeg(data) and _JPEG_END not in data[-_JPEG_TAIL_BYTES:]
    )
    if truncated or not data:
        raise InputError(f'{name}: truncated image ({len(data)} bytes); fetch the file again')


def decode_color(data: ImageData, name: object) -> ByteArray:
    """Return the (H, W, 3) uint8 BGR image of a PNG or JPEG file; pixels are returned as they are.

    InputError (text begins with `name`): the data is truncated, no image, too large, or damaged.
    """
    if isinstance(data, np.ndarray):
        return data
    return cast('ByteArray', _decode(data, COLOR_READ_FLAGS, name))


def decode_depth(data: ImageData, name: object) -> NDArray[Any]:
    """Return the (H, W) uint16 depth, in the units of the file, of a 16-bit gray PNG.

    Pixels, which may be floats, are returned as they are. InputError as in `decode_color`, and for
    an image of another kind.
    """
    if isinstance(data, np.ndarray):
        return data
    image = _decode(data, cv2.IMREAD_UNCHANGED, name)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise InputError(
            f'{name}: depth must be 16-bit gray,'
            f' got {image.dtype.itemsize * 8}-bit with {channels} channel(s)'
        )
    return image


def check_size(image: NDArray[Any], camera: CameraModel, name: object) -> None:
    """Raise InputError unless an image has the size of the camera; the text begins with `name`."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise InputError(
            f'{name}: image is {width}x{height}, the camera {camera.width_px}x{camera.height_px};'
            ' give the camera of this recording with --calibration'
        )


def _decode(data: bytes, flags: int, name: object) -> NDArray[Any]:
    check_complete(data, name)
    with prefixed(f'{name}: ', InputError, MessageError):
        return decode_image(data, flags, 'image')
