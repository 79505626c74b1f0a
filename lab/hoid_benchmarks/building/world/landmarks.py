"""The landmarks on the walls, floors and furniture of a building's cells.

They are created when a camera comes near, from a seed of the cell's own, so that a building of
any size needs little memory.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from hoid_benchmarks.building.world.floors import Building, Cell, CellKind
from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray

DESCRIPTOR_BYTES = 32
_WALL_DENSITY = 570.0  # landmarks per m^2
_GROUND_DENSITY = 130.0
_POSTERS_PER_M2 = 0.25
_POSTER_SIGMA_M = 0.3
# Distance up to which a landmark can be detected: the least, and the most.
_MIN_RANGE_M, _MAX_RANGE_M = 1.2, 20.0
_BOXES_PER_ROOM = 3
_CACHED_CELLS = 40
_ON_WALL_M = 1e-3
_LANDMARKS_SEED, _TEMPLATE_SEED = 7, 11


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The N landmarks of a cell, sorted along `axis`, the cell's longer horizontal axis."""

    axis: int
    position_m: Float32Array  # (N, 3)
    normal: Float32Array  # (N, 3)
    max_range_m: Float32Array  # (N,) up to which it can be detected
    response: Float32Array  # (N,) mean corner strength in [0, 1]
    angle_deg: Float32Array  # (N,)
    descriptors: ByteArray  # (N, 32)
    # (N, 2, 32) bits that flip in views from the left and from the right of the normal
    side_bits: ByteArray
    ids: IntArray  # (N,) unique in the building


@dataclass(frozen=True, eq=False)
class _Surface:
    """The landmarks of a cell in its own frame, whose origin is its lowest corner."""

    position_m: Float32Array
    normal: Float32Array
    max_range_m: Float32Array
    response: Float32Array
    angle_deg: Float32Array
    descriptors: ByteArray
    side_bits: ByteArray


class LandmarkStore:
    """Creates the landmarks of a building on demand."""

    def __init__(self, building: Building) -> None:
        self._building = building
        self._numbers = {key: n for n, key in enumerate(building.cells)}
        self._cached: OrderedDict[int, Landmarks] = OrderedDict()

    def of(self, cell: Cell) -> Landmarks:
        """Return the landmarks of a cell, the same at each call."""
        number = self._numbers[cell.key]
        if number in self._cached:
            self._cached.move_to_end(number)
            return self._cached[number]
        landmarks = self._cached[number] = self._create(cell, number)
        if len(self._cached) > _CACHED_CELLS:
            self._cached.popitem(last=False)
        return landmarks

    def _create(self, cell: Cell, number: int) -> Landmarks:
        seed = self._building.seed
        rng = np.random.default_rng([seed, _LANDMARKS_SEED, *cell.key])
        size_m = cell.high_m - cell.low_m
        is_room = cell.key.kind is CellKind.ROOM
        surface = _surface(rng, size_m, is_room)
        if cell.period_m is not None:
            surface = _repeated(surface, cell.period_m, float(size_m[0]))
        if cell.template is not None:
            common = np.random.default_rng([seed, _TEMPLATE_SEED, *cell.template])
            own = rng.random(len(surface.max_range_m)) < cell.own_share
            surface = _joined(_surface(common, size_m, is_room), surface, own)
        position_m, normal = surface.position_m, surface.normal
        if cell.key.north:  # turned by 180 degrees, because its door is in the northern wall
            position_m[:, :2] = size_m[:2].astype(np.float32) - position_m[:, :2]
            normal[:, :2] *= -1
        position_m += cell.low_m.astype(np.float32)
        is_wall = np.ones(len(position_m), np.bool_)
        for _, opening in cell.neighbors:
            in_plane = np.abs(position_m[:, opening.axis] - opening.at_m) < _ON_WALL_M
            is_wall &= ~(in_plane & opening.contains(position_m))
        axis = int(np.argmax(size_m[:2]))
        order = np.flatnonzero(is_wall)
        order = order[np.argsort(position_m[order, axis], kind='stable')]
        columns = {f.name: getattr(surface, f.name)[order] for f in fields(surface)}
        ids = (number << 20) + np.arange(len(order))
        return Landmarks(axis, **columns, ids=ids)


def _joined(a: _Surface, b: _Surface, of_b: object) -> _Surface:
    return _Surface(
        *(np.concatenate([getattr(a, f.name), getattr(b, f.name)[of_b]]) for f in fields(_Surface))
    )


def _repeated(surface: _Surface, period_m: float, length_m: float) -> _Surface:
    """Return the first period of a surface along x over and over, without walls across it."""
    first = (surface.position_m[:, 0] < period_m) & (surface.normal[:, 0] == 0)
    count = int(np.ceil(length_m / period_m))
    copies = _Surface(
        *(np.concatenate([getattr(surface, f.name)[first]] * count) for f in fields(_Surface))
    )
    start_m = np.repeat(np.arange(count, dtype=np.float32) * np.float32(period_m), first.sum())
    copies.position_m[:, 0] += start_m
    inside = copies.position_m[:, 0] < length_m
    return _Surface(*(getattr(copies, f.name)[inside] for f in fields(_Surface)))


def _surface(rng: np.random.Generator, size_m: FloatArray, is_furnished: bool) -> _Surface:
    """Return landmarks on the inside of a box and, if furnished, on boxes along its far wall.

    The furniture hides nothing.
    """
    w, d, h = size_m.tolist()
    faces = [
        _face(rng, (0, 0, 0), (w, 0, 0), (0, 0, h), (0, 1, 0), _WALL_DENSITY),
        _face(rng, (0, d, 0), (w, 0, 0), (0, 0, h), (0, -1, 0), _WALL_DENSITY),
        _face(rng, (0, 0, 0), (0, d, 0), (0, 0, h), (1, 0, 0), _WALL_DENSITY),
        _face(rng, (w, 0, 0), (0, d, 0), (0, 0, h), (-1, 0, 0), _WALL_DENSITY),
        _face(rng, (0, 0, 0), (w, 0, 0), (0, d, 0), (0, 0, 1), _GROUND_DENSITY),
        _face(rng, (0, 0, h), (w, 0, 0), (0, d, 0), (0, 0, -1), _GROUND_DENSITY),
    ]
    for _ in range(_BOXES_PER_ROOM if is_furnished else 0):
        bw, bd, bh = rng.uniform(0.6, 1.4), 0.5, rng.uniform(0.5, 1.6)
        x, y = rng.uniform(0.1, w - bw - 0.1), d - bd
        faces += [
            _face(rng, (x, y, 0), (bw, 0, 0), (0, 0, bh), (0, -1, 0), _WALL_DENSITY),
            _face(rng, (x, y, 0), (0, bd, 0), (0, 0, bh), (-1, 0, 0), _WALL_DENSITY),
            _face(rng, (x + bw, y, 0), (0, bd, 0), (0, 0, bh), (1, 0, 0), _WALL_DENSITY),
        ]
    position_m = np.concatenate([points for points, _ in faces]).astype(np.float32)
    n = len(position_m)
    sides = rng.integers(0, 256, (4, n, 2, DESCRIPTOR_BYTES), dtype=np.uint8)
    return _Surface(
        position_m,
        np.concatenate([normals for _, normals in faces]).astype(np.float32),
        # A landmark of a random size is found from a distance that is proportional to the size.
        np.minimum(_MIN_RANGE_M / np.sqrt(1 - rng.random(n)), _MAX_RANGE_M).astype(np.float32),
        rng.random(n, np.float32),
        rng.uniform(0, 360, n).astype(np.float32),
        rng.integers(0, 256, (n, DESCRIPTOR_BYTES), dtype=np.uint8),
        np.bitwise_and.reduce(sides),  # one bit of 16: about 16 of the 256
    )


def _face(
    rng: np.random.Generator,
    origin_m: Sequence[float],
    u_m: Sequence[float],
    v_m: Sequence[float],
    normal: Sequence[float],
    density: float,
) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) on a rectangle and their normals (N, 3).

    One half of them is spread evenly, the other one in clusters ("posters").
    """
    u, v = np.asarray(u_m, float), np.asarray(v_m, float)
    length_u, length_v = np.linalg.norm(u), np.linalg.norm(v)
    area = length_u * length_v
    n = rng.poisson(density * area)
    s, t = rng.random(n), rng.random(n)
    num_posters = max(1, int(_POSTERS_PER_M2 * area))
    center_s, center_t = rng.random(num_posters), rng.random(num_posters)
    poster, in_poster = rng.integers(num_posters, size=n), rng.random(n) < 0.5
    around_s = center_s[poster] + rng.normal(0, _POSTER_SIGMA_M / length_u, n)
    around_t = center_t[poster] + rng.normal(0, _POSTER_SIGMA_M / length_v, n)
    s = np.where(in_poster, np.clip(around_s, 0, 1), s)
    t = np.where(in_poster, np.clip(around_t, 0, 1), t)
    points = np.asarray(origin_m, float) + s[:, None] * u + t[:, None] * v
    return points, np.tile(np.asarray(normal, float), (n, 1))
