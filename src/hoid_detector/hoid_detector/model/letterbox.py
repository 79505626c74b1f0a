"""Conversion of images to network inputs (letterboxing), and of boxes back to the image."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array
from hoid_detector.model.layouts import Preprocessing

PAD_GRAY = 114  # padding value that the YOLO family is trained with


class Placement(NamedTuple):
    """Placement of an image in the network input: input_px = image_px * scale + offset_px."""

    image_width_px: int
    image_height_px: int
    scale_x: float
    scale_y: float
    left_px: int
    top_px: int
    width_px: int  # of the resized image
    height_px: int

    def boxes_to_image(self, boxes_xyxy_px: Float32Array, *, clip: bool = True) -> Float32Array:
        """Return boxes (N, 4) in image pixels; with `clip`, they are limited to the image."""
        offset = np.array([self.left_px, self.top_px] * 2, np.float32)
        scale = np.array([self.scale_x, self.scale_y] * 2, np.float32)
        limit = np.array([self.image_width_px, self.image_height_px] * 2, np.float32)
        boxes: Float32Array = (boxes_xyxy_px - offset) / scale
        return np.clip(boxes, 0, limit) if clip else boxes


class Letterbox:
    """Converts images to network inputs; each call reuses the same buffer."""

    def __init__(self, preprocessing: Preprocessing, dtype: type[np.number[Any]]) -> None:
        self._preprocessing = preprocessing
        self._dtype = dtype
        self._blob: NDArray[np.number[Any]] = np.empty(0, dtype)
        self._padded_for: tuple[Placement, tuple[int, int]] | None = None
        is_unit = preprocessing.unit_range and dtype is not np.uint8  # which has no fractions
        values = np.arange(256) / 255 if is_unit else np.arange(256)
        self._value_of_byte = values.astype(dtype)

    def __call__(
        self, image_bgr: ByteArray, size_wh: tuple[int, int]
    ) -> tuple[NDArray[np.number[Any]], Placement]:
        """Return the network input (1, 3, H, W) and the placement of the image in it.

        The next call overwrites the returned array.
        """
        height, width = image_bgr.shape[:2]
        place = placement((width, height), size_wh, self._preprocessing.placement)
        if self._padded_for != (place, size_wh):
            pad = self._value_of_byte[PAD_GRAY]
            self._blob = np.full((1, 3, size_wh[1], size_wh[0]), pad, self._dtype)
            self._padded_for = (place, size_wh)
        resized: NDArray[Any] = image_bgr
        if (width, height) != (place.width_px, place.height_px):
            resized = cv2.resize(image_bgr, (place.width_px, place.height_px))
        rows = slice(place.top_px, place.top_px + place.height_px)
        columns = slice(place.left_px, place.left_px + place.width_px)
        planes = cv2.split(resized)[:: -1 if self._preprocessing.rgb else 1]
        for channel, plane in enumerate(planes):
            self._fill(plane, self._blob[0, channel, rows, columns])
        return self._blob, place

    def _fill(self, plane: Any, out: NDArray[np.number[Any]]) -> None:
        if self._dtype is np.float32:
            np.multiply(plane, self._value_of_byte[1], out=out)
        else:  # measured: a table is 2.6 times as fast as half-float arithmetic
            np.take(self._value_of_byte, plane, out=out, mode='clip')


@lru_cache(maxsize=8)
def placement(image_wh: tuple[int, int], network_wh: tuple[int, int], mode: str) -> Placement:
    """Return the placement of an image in the network input.

    Args:
        image_wh: Width and height of the image.
        network_wh: Width and height of the network input.
        mode: 'centered', 'top_left' or 'stretch', as in `Preprocessing.placement`.
    """
    scales = (network_wh[0] / image_wh[0], network_wh[1] / image_wh[1])
    if mode == 'stretch':
        return Placement(*image_wh, *scales, 0, 0, *network_wh)
    scale = min(scales)
    width, height = (max(1, round(side * scale)) for side in image_wh)
    left, top = (network_wh[0] - width) // 2, (network_wh[1] - height) // 2
    if mode == 'top_left':
        left = top = 0
    return Placement(*image_wh, scale, scale, left, top, width, height)


def open_size(image_wh: tuple[int, int], longest_px: int, stride_px: int = 32) -> tuple[int, int]:
    """Return the input size (width, height) for a model that accepts any size.

    Each side is the smallest multiple of the stride that holds the scaled image.

    Args:
        image_wh: Width and height of the image.
        longest_px: Longer side of the scaled image.
        stride_px: Stride of the model; 32 is the coarsest stride of the YOLO family.
    """
    scale = longest_px / max(image_wh)
    width, height = (max(1, -(-round(side * scale) // stride_px)) * stride_px for side in image_wh)
    return width, height
