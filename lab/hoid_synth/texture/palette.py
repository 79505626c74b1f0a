"""Random materials of one scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.values import ByteArray
from hoid_synth.mesh import Surface
from hoid_synth.noise import Bgr, Rng, any_color, hsv
from hoid_synth.texture import pictures, surfaces
from hoid_synth.texture.atlas import Textures


@dataclass(frozen=True, eq=False)
class Studio:
    """Makes surfaces: a texture collection, a random generator and a resolution."""

    textures: Textures
    rng: Rng
    texels_per_m: float

    def shape(self, width_m: float, height_m: float, detail: float = 1.0) -> tuple[int, int]:
        """Return the shape (rows, columns) of a texture for a size in m."""
        texels = self.texels_per_m * detail
        return max(16, round(height_m * texels)), max(16, round(width_m * texels))

    def paint(self) -> Rng:
        """Return a separate generator, so that the texture size does not change later numbers."""
        return np.random.default_rng(int(self.rng.integers(0, 1 << 62)))

    def tile(self, image: ByteArray, size_m: tuple[float, float], ir_dark: float = 0.0) -> Surface:
        """Return a repeating surface."""
        return Surface(self.textures.add(image, wrap=True, ir_dark=ir_dark), size_m)

    def sheet(self, image: ByteArray, glow: float = 0.0, ir_dark: float = 0.0) -> Surface:
        """Return a surface that is stretched over its patch."""
        return Surface(self.textures.add(image, glow=glow, ir_dark=ir_dark))

    def plain(self, color: Bgr, ir_dark: float = 0.0) -> Surface:
        """Return slightly stained paint, plastic or metal."""
        return self.tile(
            surfaces.plaster(self.paint(), self.shape(0.5, 0.5), color), (0.5, 0.5), ir_dark
        )

    def wood(self, color: Bgr) -> Surface:
        """Return varnished wood."""
        return self.tile(surfaces.wood(self.paint(), self.shape(1.2, 0.8), color), (1.2, 0.8))


@dataclass(frozen=True)
class Palette:
    """Materials shared by the objects of a scene."""

    wall: Surface
    accent: Surface
    floor: Surface
    ceiling: Surface
    wood: Surface
    dark_wood: Surface
    white: Surface
    metal: Surface
    black: Surface
    upholstery: Surface
    cushion: Surface
    curtain: Surface
    leaf: Surface
    clay: Surface


def wood_color(rng: Rng, value: tuple[float, float]) -> Bgr:
    """Return a random brown BGR color."""
    return hsv(rng.uniform(18, 34), rng.uniform(0.35, 0.62), rng.uniform(*value))


def _cloth(studio: Studio) -> Surface:
    rng, shape = studio.rng, studio.shape(0.8, 0.8)
    color = any_color(rng, (0.25, 0.7), (0.35, 0.75))
    ink = any_color(rng, (0.1, 0.7), (0.3, 0.95))
    patterned = (surfaces.plaid, surfaces.dotted)[int(rng.integers(0, 2))]
    plain = rng.random() < 0.33
    paint = studio.paint()
    image = surfaces.cloth(paint, shape, color) if plain else patterned(paint, shape, color, ink)
    return studio.tile(image, (0.8, 0.8))


def make_palette(studio: Studio) -> Palette:
    """Return random materials."""
    rng = studio.rng
    wall_hue = rng.uniform(20, 220)
    wall = hsv(wall_hue, rng.uniform(0.04, 0.16), rng.uniform(0.72, 0.86))
    accent = hsv(wall_hue + rng.uniform(-30, 30), rng.uniform(0.15, 0.4), rng.uniform(0.55, 0.8))
    ink = any_color(rng, (0.2, 0.6), (0.3, 0.6))
    wide = studio.shape(3.0, 2.6, 0.8)
    floor_size = (2.4, 2.4)
    floor_shape = studio.shape(*floor_size, 0.8)
    floors = (surfaces.parquet, surfaces.parquet, surfaces.tiles, surfaces.carpet)
    floor = floors[int(rng.integers(0, 4))](
        studio.paint(), floor_shape, wood_color(rng, (0.45, 0.68))
    )
    return Palette(
        wall=studio.tile(surfaces.plaster(studio.paint(), wide, wall), (3.0, 2.6)),
        accent=studio.tile(
            surfaces.wallpaper(studio.paint(), studio.shape(1.5, 1.3), accent, ink), (1.5, 1.3)
        ),
        floor=studio.tile(floor, floor_size),
        ceiling=studio.tile(
            surfaces.plaster(studio.paint(), wide, (225.0, 228.0, 230.0)), (3.0, 2.6)
        ),
        wood=studio.wood(wood_color(rng, (0.62, 0.82))),
        dark_wood=studio.wood(wood_color(rng, (0.28, 0.45))),
        white=studio.plain((214.0, 218.0, 220.0)),
        metal=studio.plain((140.0, 140.0, 138.0), 0.3),
        black=studio.plain((36.0, 36.0, 38.0), 0.5),
        upholstery=_cloth(studio),
        cushion=_cloth(studio),
        curtain=_cloth(studio),
        leaf=studio.sheet(
            surfaces.leaf(
                studio.paint(), studio.shape(0.2, 0.5), hsv(rng.uniform(90, 130), 0.6, 0.5)
            )
        ),
        clay=studio.plain(hsv(rng.uniform(8, 30), 0.55, rng.uniform(0.5, 0.75))),
    )


def picture(studio: Studio, width_m: float, height_m: float) -> Surface:
    """Return a poster or a framed picture."""
    rng, shape = studio.rng, studio.shape(width_m, height_m, 1.5)
    if rng.random() < 0.45:
        return studio.sheet(pictures.poster(studio.paint(), shape))
    image = (pictures.landscape if rng.random() < 0.6 else pictures.abstract)(
        studio.paint(), shape
    )
    return studio.sheet(pictures.framed(image, wood_color(rng, (0.2, 0.7)), (225.0, 230.0, 232.0)))
