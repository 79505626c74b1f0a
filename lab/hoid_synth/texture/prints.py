"""Procedural prints, such as book spines, screens and faces, as (H, W, 3) BGR bytes."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import ByteArray
from hoid_synth.noise import (
    Bgr,
    Rng,
    Shape,
    any_color,
    as_bytes,
    fractal,
    grain,
    mixed,
    smoothstep,
    tinted,
)
from hoid_synth.texture.pictures import filled, landscape, lines_of_text, shapes, word, write


def book_spines(rng: Rng, shape: Shape) -> ByteArray:
    """Return the book spines of a shelf, black above the books as in shadow."""
    height, width = shape
    image = filled(shape, (22, 26, 30))
    x = 1
    while x < width - 4:
        thick = int(rng.uniform(0.016, 0.06) * width) + 2
        if rng.random() < 0.06:
            x += thick
            continue
        top = int(height * rng.uniform(0.04, 0.34))
        _spine(rng, image[top:, x : min(x + thick, width - 1)])
        x += thick
    return image


def _spine(rng: Rng, spine: ByteArray) -> None:
    height, width = spine.shape[:2]
    color = any_color(rng, (0.1, 0.85), (0.2, 0.95))
    ink = any_color(rng, (0.0, 0.6), (0.75, 1.0) if sum(color) < 380 else (0.05, 0.25))
    spine[:] = np.asarray(color, np.uint8)
    for y in rng.uniform(0.05, 0.95, int(rng.integers(1, 4))):
        cv2.line(spine, (0, int(y * height)), (width, int(y * height)), ink, max(1, height // 60))
    title = np.zeros((width, height, 3), np.uint8)
    write(
        title,
        word(rng, 14),
        (height * rng.uniform(0.1, 0.3), width * 0.72),
        width * 0.55,
        (255, 255, 255),
    )
    mask = cv2.rotate(title, cv2.ROTATE_90_CLOCKWISE)[..., :1] / 255.0
    spine[:] = (spine * (1 - mask) + np.asarray(ink) * mask).astype(np.uint8)
    curve = 1 - 0.3 * np.abs(np.linspace(-1, 1, width)) ** 3
    spine[:] = (spine * curve[None, :, None]).astype(np.uint8)


def screen(rng: Rng, shape: Shape) -> ByteArray:
    """Return a computer screen with windows of code and pictures."""
    height, width = shape
    image = landscape(rng, shape)
    for _ in range(3):
        w, h = (int(n * rng.uniform(0.35, 0.6)) for n in (width, height))
        x, y = (
            int(rng.uniform(0.02, 0.98) * (width - w)),
            int(rng.uniform(0.02, 0.98) * (height - h)),
        )
        dark = rng.random() < 0.6
        cv2.rectangle(image, (x, y), (x + w, y + h), (40, 34, 30) if dark else (244, 244, 244), -1)
        cv2.rectangle(image, (x, y), (x + w, y + max(3, h // 14)), (150, 120, 90), -1)
        ink = any_color(rng, (0.2, 0.6), (0.8, 1.0)) if dark else (40.0, 40.0, 40.0)
        lines_of_text(rng, image, (x + 4, y + h * 0.1, x + w - 4, y + h - 4), height * 0.028, ink)
    cv2.rectangle(image, (0, height - height // 18), (width, height), (60, 50, 45), -1)
    return image


def keyboard(rng: Rng, shape: Shape) -> ByteArray:
    """Return rows of keys."""
    height, width = shape
    image = filled(shape, (34, 34, 36))
    for row in range(5):
        y = int((row + 0.12) * height / 5)
        x = width * 0.01 * (1 + row)
        while x < width * 0.95:
            key = width * (0.06 if rng.random() < 0.88 else 0.13)
            corner = (int(x + key * 0.86), y + int(height * 0.15))
            cv2.rectangle(image, (int(x), y), corner, (70, 68, 66), -1)
            write(
                image,
                word(rng)[0],
                (x + key * 0.2, y + height * 0.12),
                height * 0.09,
                (215, 215, 215),
            )
            x += key
    return image


def paper(rng: Rng, shape: Shape) -> ByteArray:
    """Return a printed page."""
    image = filled(shape, (236, 240, 242))
    height, width = shape
    lines_of_text(
        rng,
        image,
        (width * 0.1, height * 0.06, width * 0.9, height * 0.94),
        height * 0.03,
        (45, 40, 40),
    )
    return image


def rug(rng: Rng, shape: Shape) -> ByteArray:
    """Return an oriental rug: borders, a medallion and rows of motifs."""
    height, width = shape
    v, u = (np.mgrid[0:height, 0:width] / np.reshape(shape, (2, 1, 1)) * 2 - 1).astype(np.float32)
    colors = [any_color(rng, (0.4, 0.85), (0.25, 0.8)) for _ in range(5)]
    edge = np.minimum(1 - np.abs(u), (1 - np.abs(v)) * height / width)
    image = np.empty((*shape, 3), np.float32)
    image[:] = colors[0]
    for limit, color in zip((0.3, 0.22, 0.1, 0.06), colors[1:], strict=True):
        image = mixed(image, color, smoothstep((limit - edge) * 90))
    diamond = np.abs(u) * 1.25 + np.abs(v) * 1.6 + 0.05 * np.cos(24 * np.arctan2(v, u))
    for limit, color in zip((0.72, 0.56, 0.36, 0.2), colors[::-1], strict=False):
        image = mixed(image, color, smoothstep((limit - diamond) * 40))
    motif = np.cos(u * 34) * np.cos(v * 34 * height / width)
    image = mixed(image, colors[4], 0.7 * smoothstep((np.abs(motif) - 0.72) * 12))
    image = mixed(
        image, colors[2], 0.6 * smoothstep((0.1 - np.abs(np.cos(u * 17) + np.cos(v * 17))) * 9)
    )
    pile = 1 + 0.08 * grain(rng, shape) + 0.09 * fractal(rng, shape, (30, 30), 4)
    return as_bytes(image * pile[..., None])


def face(rng: Rng, shape: Shape, skin: Bgr, hair: Bgr) -> ByteArray:
    """Return the unrolled texture of a head: face in the middle, ears at the quarters."""
    height, width = shape
    image = tinted(skin, 1 + 0.03 * fractal(rng, shape, (20, 20), 4))

    def at(x: float, y: float) -> tuple[int, int]:
        return int(width * x), int(height * y)

    dark = tuple(0.35 * c for c in skin)
    lips = (0.62 * skin[0], 0.55 * skin[1], 0.9 * skin[2])
    for side in (-1, 1):
        x = 0.5 + 0.062 * side
        cv2.ellipse(
            image, at(x, 0.455), at(0.026, 0.02), 0, 0, 360, (235, 238, 240), -1, cv2.LINE_AA
        )
        cv2.circle(image, at(x, 0.455), max(1, int(width * 0.012)), (45, 50, 60), -1, cv2.LINE_AA)
        cv2.ellipse(image, at(x, 0.42), at(0.04, 0.02), 0, 190, 350, hair, 2, cv2.LINE_AA)
        cv2.ellipse(
            image, at(0.5 + 0.25 * side, 0.5), at(0.02, 0.05), 0, 0, 360, dark, 2, cv2.LINE_AA
        )
        cv2.circle(image, at(0.5 + 0.012 * side, 0.56), max(1, int(width * 0.006)), dark, -1)
    cv2.line(image, at(0.5, 0.47), at(0.508, 0.55), dark, 1, cv2.LINE_AA)
    cv2.ellipse(image, at(0.5, 0.64), at(0.045, 0.018), 0, 0, 360, lips, -1, cv2.LINE_AA)
    cv2.line(image, at(0.457, 0.64), at(0.543, 0.64), dark, 1, cv2.LINE_AA)
    return as_bytes(image)


def clock(rng: Rng, shape: Shape) -> ByteArray:
    """Return a clock's dial."""
    image = filled(shape, (240, 242, 242))
    center = np.array([shape[1] / 2, shape[0] / 2])
    radius = min(shape) * 0.42
    for k in range(12):
        way = np.array([np.sin(k * np.pi / 6), -np.cos(k * np.pi / 6)])
        ends = [(center + way * radius * r).astype(int).tolist() for r in (0.82, 1.0)]
        cv2.line(image, ends[0], ends[1], (30, 30, 30), 3, cv2.LINE_AA)
    for length, angle in zip((0.5, 0.8), rng.uniform(0, 2 * np.pi, 2), strict=True):
        end = center + radius * length * np.array([np.sin(angle), -np.cos(angle)])
        cv2.line(
            image,
            center.astype(int).tolist(),
            end.astype(int).tolist(),
            (20, 20, 20),
            4,
            cv2.LINE_AA,
        )
    return image


def label(rng: Rng, shape: Shape, base: Bgr, ink: Bgr) -> ByteArray:
    """Return the print of a bottle or cup: a band with a word, and small shapes."""
    image = filled(shape, base)
    height, width = shape
    cv2.rectangle(image, (0, int(height * 0.3)), (width, int(height * 0.7)), ink, -1)
    for x in (0.08, 0.58):
        write(image, word(rng, 6).upper(), (width * x, height * 0.56), height * 0.16, base, 1)
    shapes(rng, image[int(height * 0.72) :], 5)
    return as_bytes(image * (1 + 0.03 * fractal(rng, shape, (20, 20), 4))[..., None])


def paneled(wood_image: ByteArray, rows: int, columns: int) -> ByteArray:
    """Return wood with a relief of panels painted on, for doors and cupboards."""
    image = wood_image.copy()
    height, width = image.shape[:2]
    for i in range(rows):
        for j in range(columns):
            x1, y1 = int((j + 0.14) * width / columns), int((i + 0.1) * height / rows)
            x2, y2 = int((j + 0.86) * width / columns), int((i + 0.9) * height / rows)
            dark = tuple(int(c * 0.45) for c in image[y1, x1])
            light = tuple(min(255, int(c * 1.4)) for c in image[y1, x1])
            cv2.rectangle(image, (x1, y1), (x2, y2), dark, 3)
            cv2.line(image, (x1, y2 + 2), (x2, y2 + 2), light, 2)
            cv2.line(image, (x2 + 2, y1), (x2 + 2, y2), light, 2)
    return image
