"""The image pyramid, and FAST corners on all its levels."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray

Int32Array = NDArray[np.int32]


class Pyramid(NamedTuple):
    """An image at several scales; level 0 is the image itself."""

    levels: tuple[ByteArray, ...]  # L gray images (H_l, W_l)
    steps_px: Float32Array  # (L, 2) width and height of a pixel of each level, in level-0 pixels


class Corners(NamedTuple):
    """The K corners on all levels of a pyramid, in order of level."""

    pyramid: Pyramid
    xy_px: Int32Array  # (K, 2) pixel positions in the corner's level
    uv_px: FloatArray  # (K, 2) the same positions in level-0 pixels
    pixel: IntArray  # (K,) nearest level-0 pixels, as indices into the flattened image
    octave: ByteArray  # (K,) index of the corner's level
    score: ByteArray  # (K,) greatest FAST threshold at which the pixel is a corner

    def __len__(self) -> int:
        return len(self.octave)


def build_pyramid(image_gray: ByteArray, num_levels: int, scale_factor: float) -> Pyramid:
    """Return the pyramid of an (H, W) image; each level is resized from the next larger one."""
    height, width = image_gray.shape
    levels = [image_gray]
    for octave in range(1, num_levels):
        scale = scale_factor**octave
        size = (max(round(width / scale), 1), max(round(height / scale), 1))
        smaller = cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR)
        levels.append(np.asarray(smaller, np.uint8))
    steps = [(width / level.shape[1], height / level.shape[0]) for level in levels]
    return Pyramid(tuple(levels), np.array(steps, np.float32))
