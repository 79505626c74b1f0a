"""Large objects that are carried, pushed or move by themselves; origin on the floor, z up."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hoid_synth.mesh import Mesh, box, ellipsoid, merged
from hoid_synth.noise import any_color
from hoid_synth.room.furniture import chair
from hoid_synth.texture import prints, surfaces
from hoid_synth.texture.palette import Palette, Studio, picture


class Mover(NamedTuple):
    """A moving object: its mesh, and its COCO class, which is empty if COCO has none."""

    class_name: str
    mesh: Mesh


def _printed_box(
    studio: Studio, p: Palette, size_m: tuple[float, float, float], floor_m: float = 0.0
) -> Mesh:
    """Return a box (width, depth, height) with a print on every side, which has many corners."""
    w, d, h = size_m
    sides = {name: picture(studio, w, h) for name in ('front', 'back')}
    sides |= {name: picture(studio, d, h) for name in ('left', 'right')}
    sides['top'] = picture(studio, w, d)
    return box((-w / 2, -d / 2, floor_m), (w / 2, d / 2, floor_m + h), p.white, sides)


def _carton(studio: Studio, p: Palette) -> Mover:
    return Mover('suitcase', _printed_box(studio, p, (0.75, 0.5, 0.6)))


def _chair(studio: Studio, p: Palette) -> Mover:
    return Mover('chair', chair(studio, p))


def _screen(studio: Studio, p: Palette) -> Mover:
    image = prints.screen(studio.paint(), studio.shape(1.1, 0.65, 1.6))
    shown = {'front': studio.sheet(image), 'back': picture(studio, 1.1, 0.65)}
    return Mover('tv', box((-0.55, -0.03, 0), (0.55, 0.03, 0.65), p.black, shown))


def _door_leaf(studio: Studio, p: Palette, class_name: str) -> Mover:
    """Return a door without its frame; the hinge is the origin."""
    faces = {name: picture(studio, 0.9, 2.05) for name in ('front', 'back')}
    return Mover(class_name, box((0, -0.02, 0.01), (0.9, 0.02, 2.05), p.wood, faces))


def _trolley(studio: Studio, p: Palette, class_name: str) -> Mover:
    load = _printed_box(studio, p, (0.9, 0.55, 0.75), 0.25)
    wheels = [
        ellipsoid((x, y, 0.08), (0.08, 0.03, 0.08), p.black, 7, 10)
        for x in (-0.38, 0.38)
        for y in (-0.22, 0.22)
    ]
    return Mover(class_name, merged([load, *wheels]))


def _robot(studio: Studio, p: Palette) -> Mover:
    base = box((-0.25, -0.25, 0.05), (0.25, 0.25, 0.35), p.metal)
    return Mover('', merged([base, _printed_box(studio, p, (0.42, 0.42, 0.8), 0.35)]))


def _ball(studio: Studio, _: Palette) -> Mover:
    rng = studio.rng
    ink, ground = any_color(rng, (0.6, 1.0), (0.6, 1.0)), any_color(rng, (0.0, 0.4), (0.8, 1.0))
    image = surfaces.dotted(studio.paint(), studio.shape(0.9, 0.5, 1.5), ground, ink)
    return Mover('', ellipsoid((0, 0, 0), (0.16, 0.16, 0.16), studio.sheet(image), 14, 21))


def _cat(studio: Studio, p: Palette) -> Mover:
    brown = any_color(studio.rng, (0.3, 0.6), (0.4, 0.8))
    image = surfaces.fur(studio.paint(), studio.shape(0.3, 0.3, 1.5), brown)
    fur = studio.tile(image, (0.3, 0.3))
    parts = [
        ellipsoid((0, 0, 0.2), (0.2, 0.075, 0.085), fur),
        ellipsoid((0.23, 0, 0.28), (0.07, 0.06, 0.065), fur),
        ellipsoid((-0.28, 0, 0.28), (0.1, 0.02, 0.02), fur, 8, 8),
    ]
    for x in (-0.12, 0.14):
        parts += [ellipsoid((x, y, 0.08), (0.025, 0.025, 0.09), p.black) for y in (-0.04, 0.04)]
    return Mover('', merged(parts))


def _wall_picture(studio: Studio, p: Palette) -> Mover:
    face = {'front': picture(studio, 1.1, 0.8)}
    return Mover('', box((-0.55, -0.015, 0), (0.55, 0.015, 0.8), p.dark_wood, face))


def _panel(studio: Studio, p: Palette) -> Mover:
    """Return two large pictures that hang from the ceiling, side by side."""
    low, high = 0.95, 2.45  # above tables and desks
    sheets = [
        box((x, -0.015, low), (x + 1, 0.015, high), p.white, {'front': picture(studio, 1, 1.5)})
        for x in (-1, 0)
    ]
    return Mover('', merged(sheets))


MAKERS: dict[str, Callable[[Studio, Palette], Mover]] = {
    'carry_box': _carton,
    'carry_chair': _chair,
    'carry_screen': _screen,
    'pull_door': lambda studio, p: _door_leaf(studio, p, 'refrigerator'),
    'push_trolley': lambda studio, p: _trolley(studio, p, 'suitcase'),
    'take_chair': _chair,
    'door': lambda studio, p: _door_leaf(studio, p, ''),
    'trolley': lambda studio, p: _trolley(studio, p, ''),
    'robot': _robot,
    'followed': _robot,
    'ball': _ball,
    'cat': _cat,
    'picture': _wall_picture,
    'panel': _panel,
}


def make_mover(event: str, studio: Studio, palette: Palette) -> Mover:
    """Return the moving object of an event in `config.EVENTS`."""
    return MAKERS[event](studio, palette)
