"""Encoding of images in files as messages, without loss of depth unless the user allows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.images import check_size, decode_color, decode_depth
from hoid_bags.storage.bag_types import COMPRESSED_IMAGE, IMAGE, Message
from hoid_bags.tum.listing import Images, ListedImage
from hoid_bags.tum.tum_folder import REGISTER_FILES
from hoid_common import topics
from hoid_common.errors import InputError, MessageError, prefixed
from hoid_common.inputs.registration import check_multiple
from hoid_common.io import images
from hoid_common.io.image_size import is_jpeg, is_png
from hoid_common.values import CameraModel

RAW, PNG, JPEG = 'raw', 'png', 'jpeg'

_COLOR_FORMATS = {JPEG: images.JPEG_FORMAT, PNG: images.PNG_FORMAT}
_MAX_MM = np.iinfo(np.uint16).max


class Encoding(NamedTuple):
    """How images are stored in a bag."""

    topic: str  # name of the topic by the convention of image_transport
    type_name: str
    message: Callable[[ListedImage], Message]


def color_encoding(camera: CameraModel, encoding: str, jpeg_quality: int) -> Encoding:
    """Return how color images are stored: RAW, PNG or JPEG.

    A file that is already PNG or JPEG, as `encoding` requests, is stored without encoding it
    again. The function `message` of the result raises InputError if a file cannot be used or
    differs in size from the camera's images, and MessageError if an image cannot be encoded.
    """

    def message(listed: ListedImage) -> Message:
        stored = listed.load()
        image_bgr = decode_color(stored, listed.path)
        check_size(image_bgr, camera, listed.path)
        if encoding == RAW:
            return bag_messages.image(listed.stamp_ns, image_bgr, 'bgr8')
        data = stored if isinstance(stored, bytes) else b''
        if encoding == JPEG and not is_jpeg(data):
            data = images.encode_jpeg(image_bgr, jpeg_quality)
        if encoding == PNG and not is_png(data):
            data = cv2.imencode('.png', image_bgr)[1].tobytes()
        return bag_messages.compressed_image(listed.stamp_ns, data, _COLOR_FORMATS[encoding])

    if encoding == RAW:
        return Encoding(topics.RGB_IMAGE, IMAGE, message)
    return Encoding(topics.compressed(topics.RGB_IMAGE), COMPRESSED_IMAGE, message)


def depth_encoding(
    listed: Images, camera: CameraModel, encoding: str, units_per_m: float, *, round_to_mm: bool
) -> Encoding:
    """Return the encoding RAW or PNG, in 16-bit millimeters if this is exact, else 32-bit meters.

    REP 118 allows both (decision 023). InputError: PNG would round the depth unless `round_to_mm`,
    or a file is no depth image. The function `message` of the result raises InputError if the
    camera's size is no multiple of the depth's, and MessageError if an image cannot be encoded.
    """
    not_mm = None if round_to_mm else first_not_whole_mm(listed, units_per_m)
    if not_mm is not None and encoding == PNG:
        raise InputError(
            f'{not_mm}: not in whole millimeters, as compressed depth must be;'
            ' use --depth raw, or --round-depth to lose up to 0.5 mm'
        )

    def message(listed: ListedImage) -> Message:
        stored = listed.load()
        units = decode_depth(stored, listed.path)
        with prefixed(f'{listed.path}: ', InputError, MessageError):
            check_multiple((units.shape[1], units.shape[0]), camera.size_px, REGISTER_FILES)
        if not_mm is not None:
            depth_m = images.depth_m_from_units(units, units_per_m)
            return bag_messages.image(listed.stamp_ns, depth_m, '32FC1')
        if encoding == RAW:
            depth_mm = mm_from_units(units, units_per_m)
            return bag_messages.image(listed.stamp_ns, depth_mm, '16UC1')
        if units_per_m == images.MM_PER_M and isinstance(stored, bytes):
            packed = images.compressed_depth_of_png(stored)
        else:
            packed = images.encode_compressed_depth(mm_from_units(units, units_per_m))
        format_ = images.COMPRESSED_DEPTH_FORMAT
        return bag_messages.compressed_image(listed.stamp_ns, packed, format_)

    if encoding == RAW:
        return Encoding(topics.DEPTH_IMAGE, IMAGE, message)
    return Encoding(topics.compressed_depth(topics.DEPTH_IMAGE), COMPRESSED_IMAGE, message)


def mm_from_units(units: NDArray[Any], units_per_m: float) -> NDArray[np.uint16]:
    """Return (H, W) uint16 depth in mm, rounded; values beyond 65.535 m become 0, no reading."""
    depth_mm = np.rint(units * (images.MM_PER_M / units_per_m))
    return np.where(depth_mm <= _MAX_MM, depth_mm, 0).astype(np.uint16)


def first_not_whole_mm(listed: Images, units_per_m: float) -> Path | None:
    """Return the first file whose depth is not exact in 16-bit millimeters; None: all are exact.

    With 1000 units per meter, all are exact and no file is read. InputError: a file is no depth.
    """
    if units_per_m == images.MM_PER_M:
        return None
    for image in listed:
        values = np.unique(decode_depth(image.load(), image.path))
        depth_mm = values * (images.MM_PER_M / units_per_m)
        exact = np.rint(depth_mm) * (units_per_m / images.MM_PER_M) == values
        if not exact.all() or depth_mm.max(initial=0) > _MAX_MM:
            return image.path
    return None
