"""Image to network input, and boxes back: resize with padding, channel order, value range."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array

PAD_GREY = 114  # the value that the YOLO family trains its padding with


@dataclass(frozen=True)
class Preprocessing:
    """What a network expects of its input."""

    rgb: bool  # else BGR
    unit_range: bool  # 0 to 1, else 0 to 255
    placement: str  # 'centered', 'top_left' or 'stretch'

    def __str__(self) -> str:
        order = 'RGB' if self.rgb else 'BGR'
        return f'{order} {"0-1" if self.unit_range else "0-255"}, {self.placement}'


class Placement(NamedTuple):
    """Where an image lies in the network input: network = image * scale + offset, in pixels."""

    image_width_px: int
    image_height_px: int
    scale_x: float
    scale_y: float
    left_px: int
    top_px: int
    width_px: int  # of the resized image
    height_px: int

    def boxes_to_image(self, boxes_xyxy_px: Float32Array) -> Float32Array:
        """Return (N, 4) boxes of the network input in the image, clipped to it."""
        offset = np.array([self.left_px, self.top_px] * 2, np.float32)
        scale = np.array([self.scale_x, self.scale_y] * 2, np.float32)
        limit = np.array([self.image_width_px, self.image_height_px] * 2, np.float32)
        boxes: Float32Array = np.clip((boxes_xyxy_px - offset) / scale, 0, limit)
        return boxes


class Letterbox:
    """Fills the network input from images; keeps its buffer from call to call."""

    def __init__(self, preprocessing: Preprocessing, dtype: type[np.floating[Any]]) -> None:
        self._preprocessing = preprocessing
        self._dtype = dtype
        self._blob: NDArray[np.floating[Any]] = np.empty(0, dtype)
        self._filled: tuple[Placement, tuple[int, int]] | None = None
        values = np.arange(256) / 255 if preprocessing.unit_range else np.arange(256)
        self._value_of_byte = values.astype(dtype)

    def __call__(
        self, image_bgr: ByteArray, size_wh: tuple[int, int]
    ) -> tuple[NDArray[np.floating[Any]], Placement]:
        """Return the network input (1, 3, H, W), reused by the next call, and the image in it."""
        height, width = image_bgr.shape[:2]
        place = placed((width, height), size_wh, self._preprocessing.placement)
        if self._filled != (place, size_wh):
            pad = self._value_of_byte[PAD_GREY]
            self._blob = np.full((1, 3, size_wh[1], size_wh[0]), pad, self._dtype)
            self._filled = (place, size_wh)
        resized: NDArray[Any] = image_bgr
        if (width, height) != (place.width_px, place.height_px):
            resized = cv2.resize(image_bgr, (place.width_px, place.height_px))
        rows = slice(place.top_px, place.top_px + place.height_px)
        columns = slice(place.left_px, place.left_px + place.width_px)
        planes = cv2.split(resized)[:: -1 if self._preprocessing.rgb else 1]
        for channel, plane in enumerate(planes):
            self._fill(plane, self._blob[0, channel, rows, columns])
        return self._blob, place

    def _fill(self, plane: Any, out: NDArray[np.floating[Any]]) -> None:
        if self._dtype is np.float32:
            np.multiply(plane, self._value_of_byte[1], out=out)
        else:  # a table is 2.6 times as fast as arithmetic in half floats
            np.take(self._value_of_byte, plane, out=out, mode='clip')


@lru_cache(maxsize=8)
def placed(image_wh: tuple[int, int], network_wh: tuple[int, int], placement: str) -> Placement:
    """Return where an image of a size lies in a network input of a size."""
    scales = (network_wh[0] / image_wh[0], network_wh[1] / image_wh[1])
    if placement == 'stretch':
        return Placement(*image_wh, *scales, 0, 0, *network_wh)
    scale = min(scales)
    width, height = (max(1, round(side * scale)) for side in image_wh)
    left, top = network_wh[0] - width, network_wh[1] - height
    centered = placement == 'centered'
    return Placement(
        *image_wh,
        scale,
        scale,
        left // 2 if centered else 0,
        top // 2 if centered else 0,
        width,
        height,
    )


def open_size(image_wh: tuple[int, int], longest_px: int, stride_px: int = 32) -> tuple[int, int]:
    """Return the smallest stride-aligned (width, height) that holds an image of a longest side."""
    scale = longest_px / max(image_wh)
    width, height = (max(1, -(-round(side * scale) // stride_px)) * stride_px for side in image_wh)
    return width, height
