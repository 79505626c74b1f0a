"""The mesh of a person: textured tubes and ellipsoids around the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.mesh import Mesh, Surface, ellipsoid, merged, tube
from hoid_synth.noise import Bgr, Rng, any_color, hsv
from hoid_synth.texture import prints, surfaces
from hoid_synth.texture.palette import Studio

_UP = np.array([0.0, 0.0, 1.0])
_HAIR_STYLES = ('short', 'long', 'bun', 'bald')


@dataclass(frozen=True)
class Build:
    """Measures of a body."""

    height_m: float
    girth: float  # 1 = average

    @property
    def leg_m(self) -> float:
        """Return the length from hip to ankle in m."""
        return 0.465 * self.height_m

    @property
    def torso_m(self) -> float:
        """Return the length from pelvis to shoulders in m."""
        return 0.303 * self.height_m

    @property
    def arm_m(self) -> float:
        """Return the length from shoulder to wrist in m."""
        return 0.315 * self.height_m


@dataclass(frozen=True)
class Wardrobe:
    """Body measures, hair and clothes of a person."""

    build: Build
    skin: Surface
    head: Surface
    hair: Surface
    hair_style: str
    shirt: Surface
    sleeve: Surface
    trousers: Surface
    shorts: bool
    shoes: Surface


@dataclass(frozen=True, eq=False)
class Joints:
    """Joint positions in the world frame in m; pairs are (right, left)."""

    forward: FloatArray  # (3,) unit, horizontal
    pelvis: FloatArray  # (3,)
    neck: FloatArray  # (3,) base of the neck
    head: FloatArray  # (3,) center
    T_world_head: FloatArray  # (4, 4); the face looks along -y
    shoulders: FloatArray  # (2, 3)
    elbows: FloatArray
    wrists: FloatArray
    hips: FloatArray
    knees: FloatArray
    ankles: FloatArray
    toes: FloatArray


def dress(studio: Studio) -> Wardrobe:
    """Return random body measures, hair and clothes."""
    rng = studio.rng
    skin = hsv(rng.uniform(14, 28), rng.uniform(0.3, 0.6), rng.uniform(0.4, 0.93))
    hair = hsv(rng.uniform(15, 40), rng.uniform(0.2, 0.65), rng.uniform(0.08, 0.6))
    style = _HAIR_STYLES[int(rng.choice(4, p=[0.4, 0.3, 0.2, 0.1]))]
    head = prints.face(studio.paint(), studio.shape(0.56, 0.3, 1.6), skin, hair)
    skin_tile = studio.tile(
        surfaces.plaster(studio.paint(), studio.shape(0.3, 0.3), skin), (0.3, 0.3)
    )
    shirt = _shirt(studio)
    return Wardrobe(
        build=Build(float(rng.uniform(1.6, 1.88)), float(rng.uniform(0.9, 1.18))),
        skin=skin_tile,
        head=studio.sheet(head),
        hair=studio.tile(
            surfaces.fur(studio.paint(), studio.shape(0.25, 0.25, 1.5), hair),
            (0.25, 0.25),
            ir_dark=0.35,
        ),
        hair_style=style,
        shirt=shirt,
        sleeve=shirt if rng.random() < 0.6 else skin_tile,
        trousers=_trousers(studio),
        shorts=bool(rng.random() < 0.15),
        shoes=studio.plain(any_color(rng, (0.0, 0.6), (0.1, 0.8))),
    )


def _shirt(studio: Studio) -> Surface:
    rng, size = studio.rng, (0.5, 0.5)
    shape = studio.shape(*size, 1.3)
    base, ink = _two_colors(rng)
    patterned = (surfaces.plaid, surfaces.stripes, surfaces.dotted, surfaces.knit)[
        int(rng.integers(0, 4))
    ]
    plain = rng.random() < 0.2
    paint = studio.paint()
    image = surfaces.cloth(paint, shape, base) if plain else patterned(paint, shape, base, ink)
    return studio.tile(image, size)


def _two_colors(rng: Rng) -> tuple[Bgr, Bgr]:
    return any_color(rng, (0.1, 0.62), (0.25, 0.85)), any_color(rng, (0.0, 0.6), (0.12, 0.95))


def _trousers(studio: Studio) -> Surface:
    rng, size = studio.rng, (0.4, 0.5)
    shape = studio.shape(*size, 1.3)
    if rng.random() < 0.55:
        return studio.tile(
            surfaces.denim(
                studio.paint(), shape, hsv(rng.uniform(205, 225), 0.5, rng.uniform(0.25, 0.6))
            ),
            size,
        )
    return studio.tile(
        surfaces.cloth(studio.paint(), shape, any_color(rng, (0.0, 0.5), (0.15, 0.6))), size
    )


def bent(
    a: FloatArray, b: FloatArray, c: FloatArray, count: int = 15, smooth: float = 0.3
) -> FloatArray:
    """Return points (count, 3) from a over b to c, with the corner rounded by a parabola."""
    t = np.linspace(0, 2, count)[:, None]
    line = np.where(t < 1, a + t * (b - a), b + (t - 1) * (c - b))
    start, end = b + smooth * (a - b), b + smooth * (c - b)
    s = np.clip((t - 1 + smooth) / (2 * smooth), 0, 1)
    curve = (1 - s) ** 2 * start + 2 * s * (1 - s) * b + s**2 * end
    return np.asarray(np.where(np.abs(t - 1) < smooth, curve, line))


def _profile(count: int, knots: list[tuple[float, float, float]]) -> FloatArray:
    """Return radii (count, 2), interpolated between knots (position in [0, 1], width, depth)."""
    at, width, depth = np.array(knots).T
    t = np.linspace(0, 1, count)
    return np.stack([np.interp(t, at, width), np.interp(t, at, depth)], -1)


_ARM = [
    (0, 0.024, 0.026),
    (0.08, 0.05, 0.054),
    (0.17, 0.054, 0.058),
    (0.45, 0.042, 0.045),
    (0.55, 0.043, 0.045),
    (1, 0.03, 0.029),
]
_LEG = [
    (0, 0.092, 0.1),
    (0.2, 0.088, 0.092),
    (0.48, 0.058, 0.062),
    (0.62, 0.06, 0.068),
    (1, 0.05, 0.052),
]
_TORSO = [
    (0, 0.17, 0.122),
    (0.1, 0.168, 0.12),
    (0.42, 0.152, 0.108),
    (0.7, 0.172, 0.118),
    (0.86, 0.178, 0.108),
    (0.94, 0.13, 0.085),
    (1, 0.06, 0.062),
]


def skin_mesh(j: Joints, w: Wardrobe) -> Mesh:
    """Return the mesh of a person; only vertices and normals depend on the pose."""
    left = np.cross(_UP, j.forward)
    s = w.build.height_m / 1.75
    g = s * w.build.girth
    middle = 0.5 * (j.pelvis + j.neck) - 0.02 * j.forward
    hem = j.pelvis - 0.02 * _UP
    parts = [
        tube(
            bent(hem, middle, j.neck + 0.03 * _UP, 17, 0.6),
            g * _profile(17, _TORSO),
            left,
            w.shirt,
            22,
        ),
        tube(
            bent(j.neck - 0.04 * _UP, j.neck + 0.03 * _UP, j.head, 7),
            np.full((7, 2), 0.056 * s),
            left,
            w.skin,
            12,
        ),
        tube(
            bent(j.pelvis - 0.13 * _UP, j.pelvis - 0.05 * _UP, j.pelvis + 0.03 * _UP, 9),
            g * _profile(9, [(0, 0.135, 0.105), (0.3, 0.186, 0.136), (1, 0.178, 0.13)]),
            left,
            w.trousers,
            22,
        ),
    ]
    for k in range(2):
        parts += _arm(j, w, k, left, s) + _leg(j, w, k, left, s, g)
    return merged([*parts, *_head(j, w, s)])


def _arm(j: Joints, w: Wardrobe, k: int, left: FloatArray, s: float) -> list[Mesh]:
    inner = j.shoulders[k] + 0.12 * (j.neck - j.shoulders[k]) + 0.015 * s * _UP
    line = bent(inner, j.elbows[k], j.wrists[k])
    radii = s * _profile(15, _ARM) * (0.93 + 0.07 * w.build.girth)
    along = (j.wrists[k] - j.elbows[k]) / np.linalg.norm(j.wrists[k] - j.elbows[k])
    hand = j.wrists[k] + np.linspace(-0.02, 0.165, 6)[:, None] * s * along
    palm = s * _profile(
        6, [(0, 0.026, 0.028), (0.35, 0.027, 0.04), (0.75, 0.022, 0.036), (1, 0.012, 0.02)]
    )
    covered = 15 if w.sleeve == w.shirt else 6
    cap = ellipsoid(
        j.shoulders[k] + [0, 0, -0.02 * s], np.array([0.06, 0.06, 0.06]) * s, w.shirt, 9, 13
    )
    return [
        tube(line[covered - 3 :], radii[covered - 3 :], left, w.skin, 12),
        tube(hand, palm, left, w.skin, 10),
        tube(line[:covered], radii[:covered] + 0.009, left, w.shirt, 12),
        cap,
    ]


def _leg(j: Joints, w: Wardrobe, k: int, left: FloatArray, s: float, g: float) -> list[Mesh]:
    line = bent(j.hips[k] + 0.03 * _UP, j.knees[k], j.ankles[k])
    radii = g * _profile(15, _LEG)
    covered = 7 if w.shorts else 15
    way = j.toes[k] - j.ankles[k]
    heel = j.ankles[k] - 0.35 * way
    foot = heel + np.linspace(0, 1.35, 7)[:, None] * way
    shape = s * _profile(
        7, [(0, 0.036, 0.042), (0.25, 0.047, 0.056), (0.7, 0.054, 0.042), (1, 0.032, 0.026)]
    )
    return [
        tube(line[covered - 3 :], radii[covered - 3 :], left, w.skin, 12),
        tube(line[:covered], radii[:covered] + 0.012, left, w.trousers, 14),
        tube(foot - 0.035 * _UP, shape, left, w.shoes, 12),
    ]


def _head(j: Joints, w: Wardrobe, s: float) -> list[Mesh]:
    radii = np.array([0.077, 0.095, 0.118]) * s
    parts = [ellipsoid((0, 0, 0), radii, w.head, 16, 25)]
    parts.append(ellipsoid((0, -0.096 * s, -0.015 * s), (0.012, 0.02, 0.018), w.skin, 6, 9))
    if w.hair_style != 'bald':
        cap = radii * [1.1, 1.06, 1.06]
        parts.append(ellipsoid((0, 0.02 * s, 0.022 * s), cap, w.hair, 12, 19, (-0.12, np.pi / 2)))
        parts.append(
            ellipsoid((0, 0.042 * s, -0.01 * s), cap * [0.97, 0.75, 0.85], w.hair, 12, 19)
        )
    if w.hair_style == 'long':
        parts.append(
            ellipsoid((0, 0.065 * s, -0.1 * s), (0.085 * s, 0.045 * s, 0.15 * s), w.hair, 12, 17)
        )
    if w.hair_style == 'bun':
        parts.append(ellipsoid((0, 0.1 * s, 0.06 * s), (0.045, 0.045, 0.045), w.hair, 9, 13))
    return [part.transformed(j.T_world_head) for part in parts]
