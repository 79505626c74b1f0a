"""Procedural pictures, such as posters and views from a window, as (H, W, 3) BGR bytes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from hoid_common.values import ByteArray, Float32Array
from hoid_synth.noise import (
    Bgr,
    Rng,
    Shape,
    any_color,
    as_bytes,
    fractal,
    hsv,
    mixed,
    smoothstep,
    tinted,
)

_LETTERS = 'abcdefghiklmnoprstuvw'
_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX)


def word(rng: Rng, longest: int = 9) -> str:
    """Return a made-up word."""
    return ''.join(rng.choice(list(_LETTERS), int(rng.integers(2, longest))))


def filled(shape: Shape, color: Sequence[float]) -> ByteArray:
    """Return an image of one color."""
    image = np.empty((*shape, 3), np.uint8)
    image[:] = np.asarray(color, np.uint8)
    return image


def write(
    image: ByteArray,
    text: str,
    at: tuple[float, float],
    height_px: float,
    color: Bgr,
    font: int = 0,
) -> None:
    """Draw text with its lower left corner at (x, y)."""
    thickness = max(1, round(height_px / 9))
    origin = (round(at[0]), round(at[1]))
    cv2.putText(image, text, origin, _FONTS[font], height_px / 22, color, thickness, cv2.LINE_AA)


def lines_of_text(
    rng: Rng, image: ByteArray, area: tuple[float, float, float, float], line_px: float, ink: Bgr
) -> None:
    """Fill a rectangle (x1, y1, x2, y2) with lines of made-up words."""
    x1, y1, x2, y2 = area
    for y in np.arange(y1 + line_px, y2, line_px * 1.6):
        words = ' '.join(word(rng) for _ in range(12))
        letters = int((x2 - x1) * rng.uniform(0.6, 1.0) / (line_px * 0.85))
        write(image, words[:letters], (x1, y), line_px, ink)


def shapes(rng: Rng, image: ByteArray, count: int) -> None:
    """Draw random shapes."""
    height, width = image.shape[:2]
    for _ in range(count):
        color = any_color(rng, (0.2, 0.9), (0.2, 1.0))
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        size = int(rng.uniform(0.04, 0.3) * width)
        match int(rng.integers(0, 4)):
            case 0:
                cv2.circle(
                    image, (x, y), size, color, -1 if rng.random() < 0.6 else 3, cv2.LINE_AA
                )
            case 1:
                cv2.rectangle(
                    image, (x, y), (x + size, y + int(size * rng.uniform(0.3, 2))), color, -1
                )
            case 2:
                corners = rng.integers(-size, size + 1, (int(rng.integers(3, 6)), 2))
                cv2.fillPoly(
                    image, [(corners + np.array([x, y])).astype(np.int32)], color, cv2.LINE_AA
                )
            case _:
                end = (x + int(rng.integers(-size, size + 1)), y + size)
                cv2.line(image, (x, y), end, color, int(rng.integers(1, 6)), cv2.LINE_AA)


def abstract(rng: Rng, shape: Shape) -> ByteArray:
    """Return abstract art."""
    image = filled(shape, any_color(rng, (0.1, 0.5), (0.5, 0.95)))
    shapes(rng, image, int(rng.integers(18, 40)))
    return as_bytes(image * (1 + 0.05 * fractal(rng, shape, (20, 20), 4))[..., None])


def landscape(rng: Rng, shape: Shape) -> ByteArray:
    """Return a painted landscape: sky, ridges one behind the other, trees."""
    height, width = shape
    v = np.linspace(0, 1, height, dtype=np.float32)[:, None] * np.ones((1, width), np.float32)
    hue = rng.uniform(180, 240)
    image = mixed(hsv(hue, 0.55, 0.9), hsv(rng.uniform(20, 60), 0.3, 1.0), smoothstep(v * 1.8))
    clouds = smoothstep(fractal(rng, shape, (40, 90), 5) * 0.7 - 0.3) * np.clip(1 - v * 2.2, 0, 1)
    image = mixed(image, (250.0, 250.0, 250.0), 0.8 * clouds)
    ground, leap = rng.uniform(0, 360), rng.uniform(-50, 50)
    for k in range(5):
        ridge = 0.35 + 0.12 * k + 0.06 * fractal(rng, (1, width), (1, width / 3), 5)
        color = hsv((ground + k * leap) % 360, 0.25 + 0.1 * k, rng.uniform(0.55, 0.85) - 0.09 * k)
        shade = 1 + 0.16 * fractal(rng, shape, (12, 20), 4)
        image = mixed(image, tinted(color, shade), smoothstep((v - ridge) * height / 2))
    return as_bytes(image)


def poster(rng: Rng, shape: Shape) -> ByteArray:
    """Return a printed poster: a picture between a headline and small print."""
    height, width = shape
    paper = any_color(rng, (0.0, 0.7), (0.75, 1.0))
    ink = any_color(rng, (0.3, 1.0), (0.05, 0.35))
    image = filled(shape, paper)
    top, bottom = int(height * 0.2), int(height * 0.74)
    margin = int(width * 0.07)
    inner = (bottom - top, width - 2 * margin)
    picture = landscape if rng.random() < 0.5 else abstract
    image[top:bottom, margin : width - margin] = picture(rng, inner)
    size = height * 0.075
    letters = max(3, int((width - 2 * margin) / (size * 0.85)))
    title = f'{word(rng)} {word(rng)}'.upper()[:letters]
    write(image, title, (margin, height * 0.14), size, ink, int(rng.integers(0, 3)))
    lines_of_text(
        rng, image, (margin, height * 0.77, width - margin, height * 0.97), height * 0.02, ink
    )
    return image


def framed(image: ByteArray, frame: Bgr, mat: Bgr, border: float = 0.05) -> ByteArray:
    """Return a picture with a mat and a frame painted around it."""
    edge = max(3, int(min(image.shape[:2]) * border))
    out = image.copy()
    for inset, color in ((0, frame), (edge, mat)):
        size = (out.shape[1] - 1 - inset, out.shape[0] - 1 - inset)
        cv2.rectangle(out, (inset, inset), size, color, edge)
    return out


def cover(rng: Rng, shape: Shape) -> ByteArray:
    """Return a book's cover."""
    image = poster(rng, shape)
    cv2.rectangle(
        image,
        (0, 0),
        (max(2, shape[1] // 14), shape[0]),
        any_color(rng, (0.4, 0.9), (0.1, 0.5)),
        -1,
    )
    return image


def outdoors(rng: Rng, shape: Shape) -> ByteArray:
    """Return the bright view from a window with its bars and curtains' shadow."""
    bright: Float32Array = landscape(rng, shape).astype(np.float32) * 0.45 + 140
    image = as_bytes(bright)
    height, width = shape
    for x in (0.0, 0.5, 1.0):
        cv2.line(
            image, (int(x * width), 0), (int(x * width), height), (225, 228, 230), width // 22
        )
    for y in (0.0, 0.35, 1.0):
        cv2.line(
            image, (0, int(y * height)), (width, int(y * height)), (225, 228, 230), width // 22
        )
    return image
