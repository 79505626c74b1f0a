"""Encoding of images in files as messages, without loss of depth unless the user allows it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_bags.bag import bag_messages
from hoid_bags.images import check_size, decode_color, decode_depth
from hoid_bags.storage.bag_types import COMPRESSED_IMAGE, IMAGE, Message
from hoid_bags.tum.listing import Images, ListedImage
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
class _Encoder:
    camera: CameraModel
    encoding: str  # RAW, PNG or, of color, JPEG

    @property
    def type_name(self) -> str:
        return IMAGE if self.encoding == RAW else COMPRESSED_IMAGE


@dataclass(frozen=True)
class ColorEncoder(_Encoder):
    """Encoder of color images as messages of a bag."""

    jpeg_quality: int  # in [1, 100], for files that are no JPEG

    @property
    def topic(self) -> str:
        raw = self.encoding == RAW
        return topics.RGB_IMAGE if raw else topics.compressed(topics.RGB_IMAGE)

    def message(self, listed: ListedImage) -> Message:
        """Return the message of an image; a file of the wanted encoding is used unchanged.

        InputError: the file cannot be used, or has another size than the camera. MessageError: the
        image cannot be encoded.
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
class DepthEncoder(_Encoder):
    """Encoder of depth images as 16UC1 in mm or 32FC1 in m (REP 118, decision 023)."""

    units_per_m: float  # depth units per meter in the files
    in_mm: bool  # True: 16UC1 in mm; False: 32FC1 in m

    @property
    def topic(self) -> str:
        raw = self.encoding == RAW
        return topics.DEPTH_IMAGE if raw else topics.compressed_depth(topics.DEPTH_IMAGE)

    def message(self, listed: ListedImage) -> Message:
        """Return the message of a depth image.

        InputError: the file cannot be used, or the camera's size is no multiple of its size.
        MessageError: the image cannot be encoded.
        """
        stored = listed.load()
        units = decode_depth(stored, listed.path)
        try:
            check_multiple((units.shape[1], units.shape[0]), self.camera.size_px, REGISTER_FILES)
        except MessageError as error:
            raise InputError(f'{listed.path}: {error}') from error
        if not self.in_mm:
            depth_m = images.depth_m_from_units(units, self.units_per_m)
            return bag_messages.image(listed.stamp_ns, depth_m, '32FC1')
        if (
            self.encoding == PNG
            and self.units_per_m == images.MM_PER_M
            and isinstance(stored, bytes)
        ):
            packed = images.compressed_depth_of_png(stored)
        else:
            depth_mm = mm_from_units(units, self.units_per_m)
            if self.encoding == RAW:
                return bag_messages.image(listed.stamp_ns, depth_mm, '16UC1')
            packed = images.encode_compressed_depth(depth_mm)
        return bag_messages.compressed_image(
            listed.stamp_ns, packed, images.COMPRESSED_DEPTH_FORMAT
        )


def mm_from_units(units: NDArray[Any], units_per_m: float) -> NDArray[np.uint16]:
    """Return (H, W) uint16 depth in mm, rounded; values beyond 65.535 m become 0, no reading."""
    depth_mm = np.rint(units * (images.MM_PER_M / units_per_m))
    return np.where(depth_mm <= _MAX_MM, depth_mm, 0).astype(np.uint16)


def first_not_whole_mm(listed: Images, units_per_m: float) -> Path | None:
    """Return the first file whose depth is not exact in 16-bit millimeters; None: all are exact.

    With 1000 units per meter, all are, and none is read. InputError for files that are no depth.
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
    listed: Images, camera: CameraModel, encoding: str, units_per_m: float, *, round_to_mm: bool
) -> DepthEncoder:
    """Return the encoder of depth: 16-bit millimeters if this is exact, else 32-bit meters.

    InputError: PNG would round the depth unless `round_to_mm`, or a file is no depth image.
    """
    not_mm = None if round_to_mm else first_not_whole_mm(listed, units_per_m)
    if not_mm is not None and encoding == PNG:
        raise InputError(
            f'{not_mm}: not in whole millimeters, as compressed depth must be;'
            ' use --depth raw, or --round-depth to lose up to 0.5 mm'
        )
    return DepthEncoder(camera, encoding, units_per_m, in_mm=not_mm is None)
