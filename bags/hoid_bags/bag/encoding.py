"""Encoding of image files as messages, without loss of depth unless the user allows it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.images import check_size, decode_color, decode_depth
from hoid_bags.storage.bag_types import COMPRESSED_IMAGE, IMAGE, Message
from hoid_bags.tum.listing import ListedImage
from hoid_bags.tum.tum_folder import REGISTER_FILES
from hoid_common import topics
from hoid_common.errors import InputError, MessageError
from hoid_common.inputs.registration import check_multiple
from hoid_common.io import images
from hoid_common.io.image_size import is_jpeg, is_png
from hoid_common.values import CameraModel

RAW, PNG, JPEG = 'raw', 'png', 'jpeg'

_COLOR_FORMATS = {JPEG: images.JPEG_FORMAT, PNG: images.PNG_FORMAT}
_MAX_MM = np.iinfo(np.uint16).max


@dataclass(frozen=True)
class ColorEncoder:
    """Encoder of color image files as messages of a bag."""

    camera: CameraModel
    encoding: str  # RAW, PNG or JPEG
    jpeg_quality: int  # in [1, 100], for files that are no JPEG

    @property
    def topic(self) -> str:
        """Return the name of the topic, by the convention of image_transport."""
        raw = self.encoding == RAW
        return topics.RGB_IMAGE if raw else topics.compressed(topics.RGB_IMAGE)

    @property
    def type_name(self) -> str:
        return IMAGE if self.encoding == RAW else COMPRESSED_IMAGE

    def message(self, listed: ListedImage) -> Message:
        """Return the message of an image file.

        If the file already has the wanted encoding, its content is used unchanged.

        Raises:
            InputError: The file cannot be read, is truncated or no image, or has another size than
                the camera.
            MessageError: The image cannot be encoded as JPEG.
        """
        stored = listed.load()
        image_bgr = decode_color(stored, listed.path)
        check_size(image_bgr, self.camera, listed.path)
        if self.encoding == RAW:
            return bag_messages.image(listed.stamp_ns, image_bgr, 'bgr8')
        data = stored if isinstance(stored, bytes) else b''
        if self.encoding == JPEG and not is_jpeg(data):
            data = images.encode_jpeg(image_bgr, self.jpeg_quality)
        if self.encoding == PNG and not is_png(data):
            data = cv2.imencode('.png', image_bgr)[1].tobytes()
        return bag_messages.compressed_image(listed.stamp_ns, data, _COLOR_FORMATS[self.encoding])


@dataclass(frozen=True)
class DepthEncoder:
    """Encoder of depth image files as 16UC1 in mm or 32FC1 in m (REP 118, decision 023)."""

    camera: CameraModel
    encoding: str  # RAW or PNG
    units_per_m: float  # depth units per meter in the files
    in_mm: bool  # True: 16UC1 in mm; False: 32FC1 in m

    @property
    def topic(self) -> str:
        """Return the name of the topic, by the convention of image_transport."""
        raw = self.encoding == RAW
        return topics.DEPTH_IMAGE if raw else topics.compressed_depth(topics.DEPTH_IMAGE)

    @property
    def type_name(self) -> str:
        return IMAGE if self.encoding == RAW else COMPRESSED_IMAGE

    def message(self, listed: ListedImage) -> Message:
        """Return the message of a depth image file.

        Raises:
            InputError: The file cannot be read, is truncated or no 16-bit gray image, or has
                another size than the camera.
            MessageError: The image cannot be encoded as PNG.
        """
        stored = listed.load()
        units = decode_depth(stored, listed.path)
        size_px = units.shape[1], units.shape[0]
        try:
            check_multiple(size_px, self.camera.size_px, REGISTER_FILES)
        except MessageError as error:
            raise InputError(f'{listed.path}: {error}') from error
        if not self.in_mm:
            depth_m = images.depth_m_from_units(units, self.units_per_m)
            return bag_messages.image(listed.stamp_ns, depth_m, '32FC1')
        if self.encoding == RAW:
            depth_mm = mm_from_units(units, self.units_per_m)
            return bag_messages.image(listed.stamp_ns, depth_mm, '16UC1')
        if self.units_per_m == images.MM_PER_M and isinstance(stored, bytes):
            packed = images.compressed_depth_of_png(stored)
        else:
            packed = images.encode_compressed_depth(mm_from_units(units, self.units_per_m))
        return bag_messages.compressed_image(
            listed.stamp_ns, packed, images.COMPRESSED_DEPTH_FORMAT
        )


def mm_from_units(units: NDArray[Any], units_per_m: float) -> NDArray[np.uint16]:
    """Return (H, W) uint16 depth in mm, rounded; values beyond 65.535 m become 0, no reading."""
    depth_mm = np.rint(units * (images.MM_PER_M / units_per_m))
    return np.where(depth_mm <= _MAX_MM, depth_mm, 0).astype(np.uint16)


def first_not_whole_mm(listed: Iterable[ListedImage], units_per_m: float) -> Path | None:
    """Return the first depth file that is not exact in 16-bit millimeters; None: all are exact.

    With 1000 units per meter, all files are exact, and none is read.

    Raises:
        InputError: A file cannot be read, is truncated, or is no 16-bit gray image.
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


def choose_depth_encoder(
    listed: tuple[ListedImage, ...],
    camera: CameraModel,
    encoding: str,
    units_per_m: float,
    *,
    round_to_mm: bool,
) -> DepthEncoder:
    """Return the encoder of depth files: 16-bit millimeters if this is exact, else 32-bit meters.

    Raises:
        InputError: PNG would round the depth and `round_to_mm` is False, or a file is no depth
            image.
    """
    if round_to_mm:
        return DepthEncoder(camera, encoding, units_per_m, in_mm=True)
    path_not_mm = first_not_whole_mm(listed, units_per_m)
    if path_not_mm is not None and encoding == PNG:
        raise InputError(
            f'{path_not_mm}: not in whole millimeters, as compressed depth must be;'
            ' use --depth raw, or --round-depth to lose up to 0.5 mm'
        )
    return DepthEncoder(camera, encoding, units_per_m, in_mm=path_not_mm is None)
