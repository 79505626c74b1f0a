"""Procedural tileable textures of building materials and cloth, as (H, W, 3) BGR bytes."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray, Float32Array
from hoid_synth.noise import (
    Bgr,
    Rng,
    Shape,
    as_bytes,
    fractal,
    grain,
    mixed,
    smoothstep,
    tinted,
    value_noise,
)


def plaster(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return painted plaster: stains, roller marks and a few chips."""
    stains = 0.018 * fractal(rng, shape, (120, 160), 4) + 0.012 * fractal(rng, shape, (14, 9), 3)
    chips = 0.6 * smoothstep((fractal(rng, shape, (9, 10), 3) - 2.9) * 3)
    base = tinted(color, 1 + stains + 0.008 * grain(rng, shape))
    return as_bytes(mixed(base, tinted(color, 0.72 + stains), chips))


def wallpaper(rng: Rng, shape: Shape, color: Bgr, ink: Bgr, motifs: int = 6) -> ByteArray:
    """Return wallpaper: repeated flowers between stripes, printed unevenly."""
    height, width = shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    cell = width / motifs
    row = np.floor(v / cell)
    x = (u + np.where(row % 2 > 0, cell / 2, 0)) % cell / cell - 0.5
    y = v % cell / cell - 0.5
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    petals = int(rng.integers(4, 8))
    flower = smoothstep((0.24 + 0.1 * np.cos(petals * angle) - radius) * 25)
    core = smoothstep((0.07 - radius) * 40)
    stripe = smoothstep((np.cos(2 * np.pi * u / cell) - 0.9) * 30)
    wear = np.clip(0.75 + 0.25 * fractal(rng, shape, (60, 60), 4), 0, 1)
    weight = np.clip(flower * 0.7 - core * 0.5 + stripe * 0.4, 0, 1) * wear
    shade = 1 + 0.02 * fractal(rng, shape, (40, 40), 4)
    return as_bytes(mixed(tinted(color, shade), tinted(ink, shade), weight))


def _grain_of_wood(rng: Rng, shape: Shape, along_rows: bool) -> Float32Array:
    long, short = 240.0, 7.0
    cells = (short, long) if along_rows else (long, short)
    rings = fractal(
        rng, shape, (short * 5, long * 1.5) if along_rows else (long * 1.5, short * 5), 3
    )
    fine = fractal(rng, shape, cells, 3, 0.7)
    return (0.55 * np.sin(rings * 5) + 0.6 * fine).astype(np.float32)


def wood(rng: Rng, shape: Shape, color: Bgr, contrast: float = 0.13) -> ByteArray:
    """Return varnished wood with its grain along u."""
    shade = 1 + contrast * _grain_of_wood(rng, shape, along_rows=True)
    knots = smoothstep((fractal(rng, shape, (7, 14), 2) - 3.1) * 3)
    return as_bytes(tinted(color, shade * (1 - 0.5 * knots)))


def parquet(rng: Rng, shape: Shape, color: Bgr, planks: int = 12) -> ByteArray:
    """Return a floor of staggered planks."""
    height, width = shape
    v, u = np.mgrid[0:height, 0:width]
    plank_height = height / planks
    row = (v / plank_height).astype(int)
    shift = rng.integers(0, width, planks)
    plank_width = width / 2
    x = (u + shift[row]) % width
    tone = rng.uniform(0.72, 1.18, (planks, 2)).astype(np.float32)[
        row, (x / plank_width).astype(int)
    ]
    gap_v = np.minimum(v % plank_height, plank_height - v % plank_height)
    gap_u = np.minimum(x % plank_width, plank_width - x % plank_width)
    seam = smoothstep(1.6 - np.minimum(gap_v, gap_u).astype(np.float32))
    shade = tone * (1 + 0.11 * _grain_of_wood(rng, shape, along_rows=True))
    scuffs = smoothstep(fractal(rng, shape, (30, 60), 4) * 0.8 - 1.4)
    return as_bytes(tinted(color, shade * (1 - 0.65 * seam) * (1 - 0.2 * scuffs)))


def tiles(rng: Rng, shape: Shape, color: Bgr, count: int = 4) -> ByteArray:
    """Return stone tiles with joints."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    ph, pw = shape[0] / count, shape[1] / count
    tone = rng.uniform(0.85, 1.12, (count, count)).astype(np.float32)
    tone = tone[(v / ph).astype(int), (u / pw).astype(int)]
    gap = np.minimum(np.minimum(v % ph, ph - v % ph), np.minimum(u % pw, pw - u % pw))
    veins = np.abs(fractal(rng, shape, (70, 70), 5))
    shade = tone * (1 + 0.1 * fractal(rng, shape, (50, 50), 5) - 0.12 * smoothstep(1 - veins * 9))
    return as_bytes(tinted(color, shade * (1 - 0.4 * smoothstep(2.2 - gap))))


def carpet(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return speckled office carpet."""
    shade = 1 + 0.1 * fractal(rng, shape, (40, 40), 5) + 0.1 * fractal(rng, shape, (3, 3), 2)
    return as_bytes(tinted(color, shade + 0.05 * grain(rng, shape)))


def _weave(shape: Shape) -> Float32Array:
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    return np.asarray(0.5 * np.sin(u * np.pi / 2) * np.sin(v * np.pi / 2), np.float32)


def folds(rng: Rng, shape: Shape, strength: float = 0.12) -> Float32Array:
    """Return the shading of creased cloth."""
    creases = 0.5 * fractal(rng, shape, (90, 30), 3) + 0.5 * fractal(rng, shape, (25, 80), 3)
    return np.asarray(1 + strength * creases + 0.05 * _weave(shape), np.float32)


def cloth(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return plain cloth with creases."""
    return as_bytes(tinted(color, folds(rng, shape) + 0.03 * grain(rng, shape)))


def denim(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return denim: twill with worn patches and side seams."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    worn = smoothstep(fractal(rng, shape, (60, 50), 3) * 0.4)
    seam = smoothstep(2.0 - np.abs((u % (shape[1] / 2)) - shape[1] / 4))
    shade = folds(rng, shape, 0.16) + 0.06 * np.sin((u + v) * 1.2) + 0.35 * worn - 0.3 * seam
    return as_bytes(tinted(color, shade + 0.05 * grain(rng, shape)))


def stripes(rng: Rng, shape: Shape, color: Bgr, ink: Bgr, count: int = 8) -> ByteArray:
    """Return cloth with stripes across u."""
    v = np.arange(shape[0], dtype=np.float32)[:, None] / shape[0]
    wave = smoothstep((np.sin(2 * np.pi * count * v) + 0.1) * 8) * np.ones(shape, np.float32)
    return as_bytes(mixed(color, ink, wave) * folds(rng, shape)[..., None])


def plaid(rng: Rng, shape: Shape, color: Bgr, ink: Bgr, count: int = 5) -> ByteArray:
    """Return a checked lumberjack cloth."""
    v, u = (np.mgrid[0 : shape[0], 0 : shape[1]] / np.reshape(shape, (2, 1, 1))).astype(np.float32)
    bands = [smoothstep((np.sin(2 * np.pi * count * x) + 0.2) * 6) for x in (u, v)]
    lines = [smoothstep((np.cos(2 * np.pi * count * x) - 0.97) * 60) for x in (u, v)]
    base = mixed(color, ink, 0.42 * (bands[0] + bands[1]))
    base = mixed(base, (235.0, 235.0, 225.0), 0.5 * np.maximum(*lines))
    return as_bytes(base * folds(rng, shape)[..., None])


def dotted(rng: Rng, shape: Shape, color: Bgr, ink: Bgr, count: int = 9) -> ByteArray:
    """Return cloth printed with small motifs of varied size."""
    image = np.empty((*shape, 3), np.float32)
    image[:] = color
    step = shape[1] / count
    for i in range(round(shape[0] / step)):
        for j in range(count):
            center = (np.array([j + 0.5 + 0.5 * (i % 2), i + 0.5]) * step).astype(int)
            size = int(step * rng.uniform(0.15, 0.36))
            cv2.circle(image, center.tolist(), size, ink, -1, cv2.LINE_AA)
    return as_bytes(image * folds(rng, shape)[..., None])


def knit(rng: Rng, shape: Shape, color: Bgr, ink: Bgr) -> ByteArray:
    """Return a pullover: knitted rows with a band of zigzag."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    stitches = 0.16 * np.sin(v * 1.3 + 2 * np.abs((u / 4) % 2 - 1)) + 0.05 * np.sin(u * 1.57)
    zigzag = np.abs((v / shape[0] + 0.03 * np.abs((u / 12) % 2 - 1)) * 6 % 3 - 1.5)
    base = mixed(color, ink, smoothstep((0.35 - zigzag) * 12))
    return as_bytes(base * (folds(rng, shape, 0.1) + stitches)[..., None])


def fur(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return plush or hair."""
    strands = fractal(rng, shape, (14, 3), 3, 0.8)
    return as_bytes(tinted(color, 1 + 0.17 * strands + 0.1 * value_noise(rng, shape, (30, 30))))


def leaf(rng: Rng, shape: Shape, color: Bgr) -> ByteArray:
    """Return a leaf with veins; v points along it."""
    v, u = (np.mgrid[0 : shape[0], 0 : shape[1]] / np.reshape(shape, (2, 1, 1))).astype(np.float32)
    rib = smoothstep(1 - np.abs(u - 0.5) * 30)
    veins = smoothstep((np.cos(2 * np.pi * (v * 9 - np.abs(u - 0.5) * 5)) - 0.8) * 6) * 0.5
    shade = 1 + 0.12 * fractal(rng, shape, (20, 20), 3)
    return as_bytes(tinted(color, shade * (1 + 0.45 * np.maximum(rib, veins))))
