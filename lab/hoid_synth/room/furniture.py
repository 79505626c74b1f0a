"""Furniture meshes: x right, y to the wall, z up; origin on the floor, middle of the back edge."""

from __future__ import annotations

import numpy as np

from hoid_common.values import ByteArray
from hoid_synth.mesh import Mesh, Surface, box, cylinder, ellipsoid, grid, merged, quad, tube
from hoid_synth.texture import pictures, prints, surfaces
from hoid_synth.texture.palette import Palette, Studio, wood_color

DESK_HEIGHT_M = 0.74
TABLE_HEIGHT_M = 0.72
SIDEBOARD_HEIGHT_M = 0.78


def _legs(
    xs: tuple[float, ...], ys: tuple[float, ...], top_m: float, half_m: float, s: Surface
) -> list[Mesh]:
    return [
        box((x - half_m, y - half_m, 0), (x + half_m, y + half_m, top_m), s)
        for x in xs
        for y in ys
    ]


def desk(p: Palette, width_m: float, depth_m: float = 0.62) -> Mesh:
    """Return a desk with a chest of drawers under its right end."""
    w, h = width_m / 2, DESK_HEIGHT_M
    parts = [box((-w, -depth_m, h - 0.035), (w, 0, h), p.wood)]
    parts += _legs((-w + 0.04,), (-depth_m + 0.05, -0.05), h - 0.035, 0.022, p.metal)
    parts.append(box((w - 0.42, -depth_m + 0.04, 0.05), (w - 0.03, -0.03, h - 0.035), p.dark_wood))
    for k in range(3):
        z = 0.1 + 0.2 * k
        parts.append(
            box((w - 0.40, -depth_m + 0.025, z), (w - 0.05, -depth_m + 0.04, z + 0.18), p.wood)
        )
        parts.append(
            box(
                (w - 0.28, -depth_m + 0.005, z + 0.11),
                (w - 0.17, -depth_m + 0.025, z + 0.13),
                p.metal,
            )
        )
    return merged(parts)


def monitor(studio: Studio, p: Palette, width_m: float = 0.56) -> Mesh:
    """Return a computer screen on its foot; origin under the foot."""
    height = width_m * 0.6
    image = prints.screen(studio.paint(), studio.shape(width_m, height, 1.6))
    face = studio.sheet(image, glow=0.55, ir_dark=0.75)
    w, z = width_m / 2, 0.12
    return merged(
        [
            box((-w - 0.015, -0.02, z), (w + 0.015, 0.02, z + height + 0.03), p.black),
            quad((-w, -0.022, z + height + 0.015), (width_m, 0, 0), (0, 0, -height), face),
            box((-0.03, 0.0, 0), (0.03, 0.03, z + 0.1), p.black),
            box((-0.13, -0.09, 0), (0.13, 0.09, 0.015), p.black),
        ]
    )


def bookshelf(studio: Studio, p: Palette, width_m: float, height_m: float = 1.95) -> Mesh:
    """Return a shelf filled with books."""
    depth, board, w = 0.3, 0.025, width_m / 2
    rows = 5
    parts = [
        box((-w, -depth, 0), (-w + board, 0, height_m), p.dark_wood),
        box((w - board, -depth, 0), (w, 0, height_m), p.dark_wood),
        quad((-w, -0.01, height_m), (width_m, 0, 0), (0, 0, -height_m), p.dark_wood),
    ]
    pitch = (height_m - 0.08) / rows
    for k in range(rows + 1):
        z = 0.06 + k * pitch
        parts.append(box((-w + board, -depth, z - board), (w - board, 0, z), p.dark_wood))
    for k in range(rows):
        z, top = 0.06 + k * pitch, 0.06 + (k + 0.88) * pitch
        inner = width_m - 2 * board
        image = prints.book_spines(studio.paint(), studio.shape(inner, top - z, 1.6))
        books = studio.sheet(image)
        y = -depth + studio.rng.uniform(0.03, 0.1)
        reach = inner * (1.0 if studio.rng.random() < 0.6 else studio.rng.uniform(0.6, 0.9))
        parts.append(
            box(
                (-w + board, y, z), (-w + board + reach, -0.02, top), p.dark_wood, {'front': books}
            )
        )
    return merged(parts)


def cupboard(
    studio: Studio, p: Palette, width_m: float, height_m: float = 1.9, depth_m: float = 0.5
) -> Mesh:
    """Return a wardrobe with paneled doors."""
    rng = studio.rng
    from_wood = prints.paneled(_wood_image(studio, width_m, height_m), int(rng.integers(2, 4)), 2)
    w = width_m / 2
    front = studio.sheet(from_wood)
    return merged(
        [
            box((-w, -depth_m, 0.06), (w, 0, height_m), p.wood, {'front': front}, omit=('back',)),
            box((-w + 0.03, -depth_m + 0.04, 0), (w - 0.03, -0.02, 0.06), p.black),
            box((-0.05, -depth_m - 0.03, 0.95), (-0.03, -depth_m, 1.1), p.metal),
            box((0.03, -depth_m - 0.03, 0.95), (0.05, -depth_m, 1.1), p.metal),
            box(
                (-w - 0.02, -depth_m - 0.02, height_m), (w + 0.02, 0, height_m + 0.03), p.dark_wood
            ),
        ]
    )


def _wood_image(studio: Studio, width_m: float, height_m: float) -> ByteArray:
    return surfaces.wood(
        studio.paint(), studio.shape(width_m, height_m), wood_color(studio.rng, (0.4, 0.7))
    )


def sideboard(studio: Studio, p: Palette, width_m: float, depth_m: float = 0.38) -> Mesh:
    """Return a low cupboard."""
    w, h = width_m / 2, SIDEBOARD_HEIGHT_M
    front = studio.sheet(prints.paneled(_wood_image(studio, width_m, h), 1, 3))
    return merged(
        [
            box((-w, -depth_m, 0.08), (w, 0, h), p.wood, {'front': front}, omit=('back',)),
            *_legs((-w + 0.05, w - 0.05), (-depth_m + 0.05, -0.05), 0.08, 0.02, p.black),
        ]
    )


def couch(p: Palette, width_m: float = 1.9) -> Mesh:
    """Return a sofa with cushions."""
    w, depth = width_m / 2, 0.88
    parts = [
        box((-w, -depth, 0.06), (w, 0, 0.3), p.upholstery),
        box((-w + 0.16, -0.24, 0.3), (w - 0.16, 0, 0.84), p.upholstery),
        box((-w, -depth, 0.3), (-w + 0.17, 0, 0.6), p.upholstery),
        box((w - 0.17, -depth, 0.3), (w, 0, 0.6), p.upholstery),
    ]
    for side in (-1, 1):
        low, high = sorted((side * 0.01, side * (w - 0.18)))
        parts.append(box((low, -depth - 0.02, 0.3), (high, -0.22, 0.44), p.upholstery))
        center = (side * (w - 0.42), -0.33, 0.62)
        parts.append(ellipsoid(center, (0.23, 0.1, 0.2), p.cushion, 9, 13))
    return merged(parts)


def chair(studio: Studio, p: Palette) -> Mesh:
    """Return a dining chair, its back to the back; origin below the seat's center."""
    seat, half = 0.45, 0.21
    frame = p.dark_wood if studio.rng.random() < 0.5 else p.wood
    parts = _legs((-half + 0.02, half - 0.02), (-half + 0.02,), seat - 0.03, 0.019, frame)
    parts += _legs((-half + 0.02, half - 0.02), (half - 0.02,), 0.93, 0.019, frame)
    parts.append(box((-half, -half, seat - 0.03), (half, half, seat), frame))
    parts.append(
        box(
            (-half + 0.015, -half + 0.01, seat),
            (half - 0.015, half - 0.04, seat + 0.035),
            p.cushion,
        )
    )
    for z in (0.56, 0.69, 0.82):
        parts.append(
            box((-half + 0.02, half - 0.03, z), (half - 0.02, half - 0.01, z + 0.09), frame)
        )
    return merged(parts)


def table(p: Palette, width_m: float, depth_m: float) -> Mesh:
    """Return a table; origin below its center."""
    w, d, h = width_m / 2, depth_m / 2, TABLE_HEIGHT_M
    return merged(
        [
            box((-w, -d, h - 0.03), (w, d, h), p.wood),
            box(
                (-w + 0.06, -d + 0.06, h - 0.1),
                (w - 0.06, d - 0.06, h - 0.03),
                p.dark_wood,
                omit=('top',),
            ),
            *_legs((-w + 0.07, w - 0.07), (-d + 0.07, d - 0.07), h - 0.03, 0.028, p.dark_wood),
        ]
    )


def plant(studio: Studio, p: Palette, height_m: float = 1.0) -> Mesh:
    """Return a pot with a bush of arching leaves; origin below the pot's center."""
    rng = studio.rng
    pot = 0.3 * height_m
    radius = 0.16 * height_m
    parts = [
        tube(
            np.array([[0, 0, 0], [0, 0, pot * 0.9], [0, 0, pot]]),
            np.array([[radius * 0.7] * 2, [radius] * 2, [radius * 1.08] * 2]),
            (1, 0, 0),
            p.clay,
            16,
        )
    ]
    for k in range(16):
        angle = k * 2.4 + rng.uniform(-0.3, 0.3)
        reach, top = rng.uniform(0.16, 0.34) * height_m, rng.uniform(0.55, 1.0) * height_m
        parts.append(_leaf(p.leaf, angle, pot * 0.9, reach, top, 0.05 * height_m))
    return merged(parts)


def _leaf(
    surface: Surface, angle: float, base_m: float, reach_m: float, top_m: float, half_m: float
) -> Mesh:
    t = np.linspace(0, 1, 9)
    out = reach_m * t**1.3
    up = base_m + (top_m - base_m) * (1.5 * t - 0.55 * t**3) / 0.95 - 0.12 * top_m * t**4
    way, side = (
        np.array([np.cos(angle), np.sin(angle), 0]),
        np.array([-np.sin(angle), np.cos(angle), 0]),
    )
    width = half_m * np.sin(np.pi * np.clip(0.08 + 0.92 * t, 0, 1)) ** 0.7
    center = out[:, None] * way + up[:, None] * [0, 0, 1.0]
    points = center[:, None] + np.array([-1, 0, 1])[None, :, None] * width[:, None, None] * side
    points[:, [0, 2], 2] += 0.25 * width[:, None]
    u, v = np.meshgrid([0.02, 0.5, 0.98], t)
    return grid(points, np.stack([u, v], -1), surface)


def floor_lamp(studio: Studio, p: Palette) -> Mesh:
    """Return a standing lamp; origin below its foot's center."""
    shade = studio.sheet(pictures.filled((32, 32), (170, 215, 240)), glow=0.8)
    centers = np.array([[0, 0, 1.35], [0, 0, 1.45], [0, 0, 1.7]])
    return merged(
        [
            cylinder((0, 0, 0), 0.03, 0.15, p.metal),
            cylinder((0, 0, 0.03), 1.35, 0.014, p.metal, 8),
            tube(
                centers, np.array([[0.21, 0.21], [0.2, 0.2], [0.13, 0.13]]), (1, 0, 0), shade, 18
            ),
        ]
    )


def window(studio: Studio, p: Palette, width_m: float, height_m: float) -> Mesh:
    """Return a window with folded curtains, on the wall plane y = 0; origin on the floor."""
    view = studio.sheet(
        pictures.outdoors(studio.paint(), studio.shape(width_m, height_m)), glow=0.85, ir_dark=0.8
    )
    w, low = width_m / 2, 0.85
    parts = [
        quad((-w, -0.02, low + height_m), (width_m, 0, 0), (0, 0, -height_m), view),
        box((-w - 0.08, -0.16, low - 0.04), (w + 0.08, 0, low), p.white),
        cylinder_rail(p, w + 0.35, low + height_m + 0.12),
    ]
    for side in (-1, 1):
        x = np.linspace(side * (w - 0.12), side * (w + 0.3), 30)
        z = np.linspace(low + height_m + 0.1, 0.12, 16)
        points = np.stack(
            np.broadcast_arrays(x[None], -0.11 + 0.035 * np.sin(x * 42)[None], z[:, None]), -1
        )
        u, v = np.meshgrid(np.linspace(0, 1, 30), np.linspace(0, 2.4, 16))
        points = points if side > 0 else points[:, ::-1]
        parts.append(grid(points[::-1], np.stack([u, v], -1), p.curtain))
    return merged(parts)


def cylinder_rail(p: Palette, half_m: float, height_m: float) -> Mesh:
    """Return a curtain rail."""
    x = np.linspace(-half_m, half_m, 5)
    centers = np.stack([x, np.full(5, -0.11), np.full(5, height_m)], -1)
    return tube(centers, np.full((5, 2), 0.015), (0, 0, 1), p.metal, 8)


def door(studio: Studio, p: Palette) -> Mesh:
    """Return a closed door in its frame."""
    leaf = studio.sheet(prints.paneled(_wood_image(studio, 0.9, 2.05), 3, 2))
    return merged(
        [
            quad((-0.45, -0.02, 2.05), (0.9, 0, 0), (0, 0, -2.05), leaf),
            box((-0.53, -0.05, 0), (-0.45, 0, 2.12), p.white),
            box((0.45, -0.05, 0), (0.53, 0, 2.12), p.white),
            box((-0.53, -0.05, 2.05), (0.53, 0, 2.13), p.white),
            box((-0.4, -0.08, 1.0), (-0.28, -0.06, 1.02), p.metal),
        ]
    )
