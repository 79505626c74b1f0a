"""All textures of a scene in one image with mip levels, so that one remap samples a frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array

LEVELS = 5
_ALIGN_PX = 1 << (LEVELS - 1)
_WIDTH_PX = 4096


@dataclass(frozen=True, eq=False)
class TextureAtlas:
    """Textures packed in one image; the mip levels are to the right of level 0."""

    image: ByteArray  # (H, W, 3) BGR
    places: Float32Array  # (T, 4) x, y, width and height (px) of each texture at level 0
    glow: Float32Array  # (T,) from 0 = lit by lamps only to 1 = emits light
    ir_dark: Float32Array  # (T,) share of depth readings lost, in [0, 1]
    level_offsets_px: Float32Array  # (LEVELS, 2) x and y

    def sample(self, xy_px: Float32Array, level: Float32Array) -> Float32Array:
        """Return colors (N, 3) at level-0 positions (N, 2), interpolated between mip levels."""
        low = np.clip(level.astype(np.int32), 0, LEVELS - 2)
        weight = np.clip(level - low, 0, 1).astype(np.float32)[:, None]
        fine, coarse = self._lookup(xy_px, low), self._lookup(xy_px, low + 1)
        return np.asarray(fine + (coarse - fine) * weight)

    def _lookup(self, xy_px: Float32Array, level: NDArray[np.int32]) -> Float32Array:
        scale = np.ldexp(np.float32(1), -level).astype(np.float32)
        at = self.level_offsets_px[level]
        x = xy_px[:, 0] * scale + at[:, 0] - np.float32(0.5)
        y = xy_px[:, 1] * scale + at[:, 1] - np.float32(0.5)
        rows = _rows(len(x))
        out = cv2.remap(self.image, x.reshape(rows), y.reshape(rows), cv2.INTER_LINEAR)
        return out.reshape(-1, 3).astype(np.float32)


def _rows(n: int) -> tuple[int, int]:
    """Return a shape for n elements with sides below 32768, as remap requires."""
    columns = next(c for c in (640, 512, 320, 256, 64, 16, 4, 2, 1) if n % c == 0)
    return n // columns, columns


class Textures:
    """Collects textures and packs them into an atlas."""

    def __init__(self) -> None:
        self._images: list[ByteArray] = []
        self._wrap: list[bool] = []
        self._glow: list[float] = []
        self._ir_dark: list[float] = []

    def add(
        self, image: ByteArray, wrap: bool = False, glow: float = 0.0, ir_dark: float = 0.0
    ) -> int:
        """Add a texture and return its index; with `wrap` it repeats beyond its edges."""
        height, width = (max(_ALIGN_PX, round(n / _ALIGN_PX) * _ALIGN_PX) for n in image.shape[:2])
        resized = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        self._images.append(np.asarray(resized, np.uint8))
        self._wrap.append(wrap)
        self._glow.append(glow)
        self._ir_dark.append(ir_dark)
        return len(self._images) - 1

    def pack(self) -> TextureAtlas:
        """Return the atlas of all textures added so far."""
        pad = _ALIGN_PX
        order = sorted(range(len(self._images)), key=lambda k: -self._images[k].shape[0])
        places = np.zeros((len(order), 4), np.float32)
        x = y = row_height = 0
        for k in order:
            height, width = (n + 2 * pad for n in self._images[k].shape[:2])
            if x + width > _WIDTH_PX:
                x, y, row_height = 0, y + row_height, 0
            places[k] = x + pad, y + pad, width - 2 * pad, height - 2 * pad
            x, row_height = x + width, max(row_height, height)
        level = np.zeros((y + row_height, _WIDTH_PX, 3), np.uint8)
        for place, image, wrap in zip(places.astype(int), self._images, self._wrap, strict=True):
            border = cv2.BORDER_WRAP if wrap else cv2.BORDER_REPLICATE
            padded = cv2.copyMakeBorder(image, pad, pad, pad, pad, border)
            x0, y0 = place[0] - pad, place[1] - pad
            level[y0 : y0 + padded.shape[0], x0 : x0 + padded.shape[1]] = padded
        image, offsets = _with_mips(level)
        glow, dark = np.array(self._glow, np.float32), np.array(self._ir_dark, np.float32)
        return TextureAtlas(image, places, glow, dark, offsets)


def _with_mips(level: ByteArray) -> tuple[ByteArray, Float32Array]:
    height, width = level.shape[:2]
    canvas = np.zeros((height, width + width // 2, 3), np.uint8)
    canvas[:, :width] = level
    offsets = np.zeros((LEVELS, 2), np.float32)
    y = 0
    for k in range(1, LEVELS):
        size = (level.shape[1] // 2, level.shape[0] // 2)
        level = np.asarray(cv2.resize(level, size, interpolation=cv2.INTER_AREA), np.uint8)
        canvas[y : y + size[1], width : width + size[0]] = level
        offsets[k] = width, y
        y += size[1]
    return canvas, offsets
