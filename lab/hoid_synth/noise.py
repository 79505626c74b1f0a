"""Noise functions and color helpers for procedural textures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array

Rng = np.random.Generator
Floats = NDArray[np.floating[Any]]
Bgr = tuple[float, float, float]
Shape = tuple[int, int]


def value_noise(rng: Rng, shape: Shape, cells: tuple[float, float]) -> Float32Array:
    """Return smooth tileable noise (H, W) of about unit variance with periods `cells` (px)."""
    grid_shape = [max(2, round(n / c)) for n, c in zip(shape, cells, strict=True)]
    small = np.pad(rng.standard_normal(grid_shape, np.float32), 2, 'wrap')
    y, x = (
        ((np.arange(n, dtype=np.float32) + 0.5) * g / n + 1.5)
        for n, g in zip(shape, grid_shape, strict=True)
    )
    map_x, map_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(small, map_x, map_y, cv2.INTER_CUBIC).astype(np.float32) * np.float32(1.3)


def fractal(
    rng: Rng, shape: Shape, cells: tuple[float, float], octaves: int = 4, gain: float = 0.6
) -> Float32Array:
    """Return tileable noise (H, W), summed over octaves, with unit variance."""
    total = np.zeros(shape, np.float32)
    for k in range(octaves):
        size = (max(cells[0] / 2**k, 1.0), max(cells[1] / 2**k, 1.0))
        total += np.float32(gain**k) * value_noise(rng, shape, size)
    return total / max(float(total.std()), 1e-6)


def grain(rng: Rng, shape: Shape) -> Float32Array:
    """Return white noise (H, W)."""
    return rng.standard_normal(shape, np.float32)


def tinted(color: Sequence[float], shade: Floats) -> Float32Array:
    """Return a BGR color times a shade (H, W) as an image (H, W, 3)."""
    return np.asarray(np.asarray(color, np.float32) * shade[..., None], np.float32)


def mixed(a: Floats | Bgr, b: Floats | Bgr, weight: Floats) -> Float32Array:
    """Return the blend of a and b with the weight (H, W) of b in [0, 1]."""
    w = weight[..., None]
    return (np.asarray(a, np.float32) * (1 - w) + np.asarray(b, np.float32) * w).astype(np.float32)


def as_bytes(image: Float32Array) -> ByteArray:
    """Return float values of 0 to 255 as bytes."""
    return np.clip(image, 0, 255).astype(np.uint8)


def smoothstep(x: Floats) -> Float32Array:
    """Return the smoothstep function of x: 0 below 0, 1 above 1."""
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x), np.float32)


def hsv(hue_deg: float, saturation: float, value: float) -> Bgr:
    """Return the BGR color (0 to 255) of a hue in degrees, and saturation and value in [0, 1]."""
    h = hue_deg / 60.0
    channel = [
        value * 255 * (1 - saturation * max(0.0, min(k, 4 - k, 1.0)))
        for k in ((n + h) % 6 for n in (5, 3, 1))
    ]
    return channel[2], channel[1], channel[0]


def any_color(rng: Rng, saturation: tuple[float, float], value: tuple[float, float]) -> Bgr:
    """Return a BGR color of random hue, with saturation and value within ranges."""
    return hsv(rng.uniform(0, 360), rng.uniform(*saturation), rng.uniform(*value))
