"""Objects that people carry; origin below the middle, z up, front towards -y."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hoid_synth.mesh import Mesh, Surface, box, ellipsoid, merged, quad, tube
from hoid_synth.noise import any_color, hsv
from hoid_synth.room.furniture import chair, plant
from hoid_synth.texture import pictures, prints, surfaces
from hoid_synth.texture.palette import Palette, Studio


@dataclass(frozen=True, eq=False)
class Prop:
    """A movable object, and how it is gripped and carried."""

    class_name: str  # class of COCO
    mesh: Mesh
    radius_m: float  # of its footprint
    two_handed: bool
    # Grip of the right hand; that of the left hand is mirrored in x.
    grip_m: tuple[float, float, float]
    # Position when carried: right of, ahead of and above the feet.
    hold_m: tuple[float, float, float]
    on_floor: bool  # whether it stands on the floor, not on furniture
    hold_yaw_rad: float = 0.0  # yaw when carried; 0: its front faces the carrier


Maker = Callable[[Studio, Palette], Prop]


def _revolved(profile: list[tuple[float, float]], surface: Surface, around: int = 16) -> Mesh:
    """Return a solid of revolution of (radius, height) pairs."""
    radius, height = np.array(profile).T
    centers = np.stack([0 * height, 0 * height, height], -1)
    return tube(centers, np.stack([radius, radius], -1), (0, 1, 0), surface, around)


def cup(studio: Studio, p: Palette) -> Prop:
    """Return a mug with a handle."""
    rng = studio.rng
    image = prints.label(
        studio.paint(),
        studio.shape(0.3, 0.12, 2.0),
        any_color(rng, (0.5, 0.9), (0.5, 1.0)),
        any_color(rng, (0.0, 0.3), (0.85, 1.0)),
    )
    body = _revolved([(0.042, 0), (0.048, 0.01), (0.05, 0.06), (0.05, 0.12)], studio.sheet(image))
    angle = np.linspace(-1.3, 1.3, 9)
    loop = np.stack([0.045 + 0.035 * np.cos(angle), 0 * angle, 0.062 + 0.038 * np.sin(angle)], -1)
    handle = tube(loop, np.full((9, 2), 0.008), (0, 1, 0), p.white, 8)
    return Prop(
        'cup', merged([body, handle]), 0.07, False, (0.05, 0, 0.06), (0.2, 0.34, 1.08), False
    )


def bottle(studio: Studio, _: Palette) -> Prop:
    """Return a bottle with a label."""
    rng = studio.rng
    glass = any_color(rng, (0.6, 0.9), (0.3, 0.6))
    image = prints.label(studio.paint(), studio.shape(0.3, 0.3, 2.0), glass, (225.0, 235.0, 240.0))
    profile = [
        (0.042, 0),
        (0.044, 0.02),
        (0.044, 0.18),
        (0.036, 0.215),
        (0.016, 0.25),
        (0.015, 0.29),
        (0.018, 0.3),
    ]
    mesh = _revolved(profile, studio.sheet(image))
    return Prop('bottle', mesh, 0.06, False, (0.045, 0, 0.12), (0.2, 0.34, 1.0), False)


def book(studio: Studio, p: Palette) -> Prop:
    """Return a book lying flat."""
    cover = studio.sheet(pictures.cover(studio.paint(), studio.shape(0.2, 0.27, 2.0)))
    back = studio.sheet(pictures.filled((32, 32), any_color(studio.rng, (0.3, 0.9), (0.2, 0.7))))
    mesh = box(
        (-0.1, -0.135, 0),
        (0.1, 0.135, 0.045),
        p.white,
        {'top': cover, 'bottom': back, 'left': back},
    )
    return Prop('book', mesh, 0.16, False, (0.1, 0, 0.03), (0.16, 0.34, 1.1), False)


def laptop(studio: Studio, p: Palette) -> Prop:
    """Return an open laptop."""
    keys = studio.sheet(prints.keyboard(studio.paint(), studio.shape(0.32, 0.2, 2.0)))
    face = studio.sheet(
        prints.screen(studio.paint(), studio.shape(0.32, 0.2, 2.0)), glow=0.5, ir_dark=0.6
    )
    lid = quad((-0.165, 0.15, 0.235), (0.33, 0, 0), (0, -0.05, -0.215), face)
    shell = quad((0.165, 0.158, 0.235), (-0.33, 0, 0), (0, -0.05, -0.215), p.metal)
    base = box((-0.17, -0.13, 0), (0.17, 0.11, 0.02), p.metal, {'top': keys})
    return Prop(
        'laptop',
        merged([base, lid, shell]),
        0.2,
        True,
        (0.17, -0.02, 0.01),
        (0.0, 0.42, 1.0),
        False,
    )


def teddy_bear(studio: Studio, p: Palette) -> Prop:
    """Return a sitting plush bear."""
    rng = studio.rng
    brown = hsv(rng.uniform(18, 36), rng.uniform(0.4, 0.65), rng.uniform(0.45, 0.7))
    fur = studio.tile(surfaces.fur(studio.paint(), studio.shape(0.3, 0.3, 1.5), brown), (0.3, 0.3))
    light = tuple(min(255.0, 1.45 * c) for c in brown)
    pale = studio.tile(
        surfaces.fur(studio.paint(), studio.shape(0.2, 0.2, 1.5), (light[0], light[1], light[2])),
        (0.2, 0.2),
    )
    parts = [
        ellipsoid((0, 0, 0.15), (0.12, 0.105, 0.15), fur),
        ellipsoid((0, -0.035, 0.15), (0.08, 0.085, 0.11), pale),
        ellipsoid((0, -0.01, 0.37), (0.105, 0.095, 0.1), fur),
        ellipsoid((0, -0.09, 0.345), (0.05, 0.045, 0.04), pale, 8, 12),
        ellipsoid((0, -0.132, 0.36), (0.016, 0.012, 0.012), p.black, 6, 9),
    ]
    for side in (-1, 1):
        parts += [
            ellipsoid((side * 0.085, 0, 0.455), (0.04, 0.02, 0.04), fur, 7, 10),
            ellipsoid((side * 0.04, -0.095, 0.395), (0.013, 0.01, 0.013), p.black, 6, 9),
            ellipsoid((side * 0.15, -0.05, 0.2), (0.055, 0.06, 0.1), fur, 8, 12),
            ellipsoid((side * 0.1, -0.15, 0.055), (0.06, 0.11, 0.055), fur, 8, 12),
            ellipsoid((side * 0.1, -0.235, 0.06), (0.042, 0.03, 0.042), pale, 7, 10),
        ]
    return Prop(
        'teddy bear', merged(parts), 0.24, True, (0.12, -0.02, 0.17), (0.0, 0.3, 0.95), False
    )


def suitcase(studio: Studio, p: Palette) -> Prop:
    """Return a hard-shell case with a handle."""
    rng = studio.rng
    shape = studio.shape(0.5, 0.62, 1.2)
    color = any_color(rng, (0.5, 0.9), (0.35, 0.8))
    image = surfaces.stripes(
        studio.paint(), shape, color, (color[0] * 0.7, color[1] * 0.7, color[2] * 0.7), 9
    )
    shell = studio.sheet(prints.paneled(image, 2, 1))
    parts = [
        box((-0.24, -0.12, 0.04), (0.24, 0.12, 0.66), shell),
        box((-0.245, -0.012, 0.04), (0.245, 0.012, 0.665), p.black),
        box((-0.09, -0.015, 0.7), (0.09, 0.015, 0.725), p.black),
    ]
    for side in (-1, 1):
        parts.append(
            box((side * 0.08 - 0.012, -0.012, 0.66), (side * 0.08 + 0.012, 0.012, 0.7), p.metal)
        )
        parts.append(box((side * 0.18 - 0.03, -0.1, 0), (side * 0.18 + 0.03, 0.1, 0.04), p.black))
    return Prop(
        'suitcase', merged(parts), 0.3, False, (0, 0, 0.71), (0.34, 0.05, 0.06), True, np.pi / 2
    )


def backpack(studio: Studio, p: Palette) -> Prop:
    """Return a rucksack with a front pocket."""
    rng = studio.rng
    color = any_color(rng, (0.4, 0.9), (0.25, 0.7))
    fabric = studio.tile(
        surfaces.cloth(studio.paint(), studio.shape(0.4, 0.4, 1.5), color), (0.4, 0.4)
    )
    other = studio.tile(
        surfaces.dotted(
            studio.paint(),
            studio.shape(0.3, 0.3, 1.5),
            any_color(rng, (0.4, 0.9), (0.3, 0.9)),
            (230.0, 230.0, 230.0),
        ),
        (0.3, 0.3),
    )
    z = np.linspace(0, 1, 8)
    center = np.stack([0 * z, 0 * z, 0.47 * z], -1)
    radii = np.stack([0.17 * (1 - 0.45 * z**4), 0.105 * (1 - 0.5 * z**4)], -1)
    parts = [
        tube(center, radii, (1, 0, 0), fabric, 18),
        ellipsoid((0, -0.1, 0.15), (0.125, 0.055, 0.12), other, 9, 14),
        box((-0.1, -0.112, 0.335), (0.1, -0.07, 0.345), p.metal),
        box((-0.05, -0.02, 0.45), (0.05, 0.02, 0.52), p.black),
    ]
    return Prop('backpack', merged(parts), 0.22, False, (0, 0, 0.49), (0.32, 0.06, 0.28), True)


def ball(studio: Studio, _: Palette) -> Prop:
    """Return a striped ball."""
    rng = studio.rng
    image = surfaces.stripes(
        studio.paint(),
        studio.shape(0.7, 0.4, 1.2)[::-1],
        any_color(rng, (0.7, 1.0), (0.6, 1.0)),
        any_color(rng, (0.0, 0.5), (0.8, 1.0)),
        4,
    )
    turned = np.ascontiguousarray(image.swapaxes(0, 1))
    mesh = ellipsoid((0, 0, 0.12), (0.12, 0.12, 0.12), studio.sheet(turned), 14, 21)
    return Prop('sports ball', mesh, 0.15, True, (0.12, 0, 0.12), (0.0, 0.34, 0.98), True)


def small_plant(studio: Studio, p: Palette) -> Prop:
    """Return a flower pot that one can carry."""
    return Prop(
        'potted plant',
        plant(studio, p, 0.5),
        0.2,
        True,
        (0.085, 0, 0.09),
        (0.0, 0.36, 0.92),
        False,
    )


def loose_chair(studio: Studio, p: Palette) -> Prop:
    """Return a chair that one can lift and carry."""
    return Prop(
        'chair', chair(studio, p), 0.32, True, (-0.19, 0.2, 0.78), (0.0, 0.52, 0.2), True, np.pi
    )


FLOOR_PROPS: tuple[Maker, ...] = (suitcase, backpack, ball, loose_chair)
TABLE_PROPS: tuple[Maker, ...] = (cup, bottle, book, teddy_bear, laptop, small_plant)
