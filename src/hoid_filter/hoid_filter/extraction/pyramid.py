"""An image at several scales, and its corners at each."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array, IntArray
from hoid_native import fast_corners

Int32Array = NDArray[np.int32]


class Pyramid(NamedTuple):
    """Levels of an image, level 0 being the image itself."""

    levels: tuple[ByteArray, ...]  # L of (H_l, W_l)
    steps_px: Float32Array  # (L, 2) level-0 pixels per pixel of each level, in x and y


class Corners(NamedTuple):
    """Corners of all levels in order of level, before any choice."""

    pyramid: Pyramid
    xy_px: Int32Array  # (K, 2) pixels of their own level
    uv_px: Float32Array  # (K, 2) level-0 pixels
    pixel: IntArray  # (K,) indices of the nearest level-0 pixels in the flat image
    octave: ByteArray  # (K,)
    score: ByteArray  # (K,), largest threshold at which each still is a corner

    def __len__(self) -> int:
        return len(self.octave)


def build_pyramid(image_gray: ByteArray, num_levels: int, scale_factor: float) -> Pyramid:
    """Return an (H, W) image in `num_levels` sizes, each made from the one before."""
    height, width = image_gray.shape
    levels = [image_gray]
    for octave in range(1, num_levels):
        scale = scale_factor**octave
        size = (max(round(width / scale), 1), max(round(height / scale), 1))
        smaller = cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR)
        levels.append(np.asarray(smaller, np.uint8))
    steps = [(width / level.shape[1], height / level.shape[0]) for level in levels]
    return Pyramid(tuple(levels), np.array(steps, np.float32))


def find_corners(pyramid: Pyramid, threshold: int, border_px: int) -> Corners:
    """Return the FAST corners of every level."""
    found = [fast_corners(level, threshold, border_px) for level in pyramid.levels]
    counts = [len(c.x) for c in found]
    octave = np.repeat(np.arange(len(found), dtype=np.uint8), counts)
    steps_px = np.repeat(pyramid.steps_px, counts, axis=0)
    xy_px = np.stack(
        [np.concatenate([c.x for c in found]), np.concatenate([c.y for c in found])], axis=1
    )
    # Pixel centres, not corners, are whole numbers: a level's pixel (0, 0) lies at (s - 1) / 2.
    uv_px = (xy_px + np.float32(0.5)) * steps_px - np.float32(0.5)
    score = np.concatenate([c.score for c in found])
    pixel = _flat_pixels(uv_px, pyramid.levels[0].shape[1])
    return Corners(pyramid, xy_px, uv_px, pixel, octave, score)


def _flat_pixels(uv_px: Float32Array, width_px: int) -> IntArray:
    """Return the (N,) indices, in a flat image, of the pixels nearest to (N, 2) positions."""
    nearest = np.rint(uv_px).astype(np.int64)
    flat: IntArray = nearest[:, 1] * width_px + nearest[:, 0]
    return flat
