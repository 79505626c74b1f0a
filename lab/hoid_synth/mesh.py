"""Triangle meshes with texture coordinates, and geometric primitives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array, FloatArray

CELL_M = 0.12  # edge of a mesh cell; light is computed at the vertices
Vector = Sequence[float] | FloatArray
Rect = tuple[float, float, float, float]  # x1, y1, x2, y2 on the floor in m

_FACES = ('left', 'right', 'front', 'back', 'bottom', 'top')  # -x +x -y +y -z +z


@dataclass(frozen=True)
class Surface:
    """A texture and the size of one repetition in m; None stretches it over the patch."""

    texture: int
    size_m: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh with V vertices and F faces."""

    vertices_m: Float32Array  # (V, 3)
    normals: Float32Array  # (V, 3), unit, outwards
    uv: Float32Array  # (V, 2), in repetitions of the texture
    faces: NDArray[np.int32]  # (F, 3)
    texture: NDArray[np.int16]  # (F,)
    instance: ByteArray  # (F,) instance of each face; 0 = background

    def transformed(self, T_a_b: FloatArray) -> Mesh:
        """Return the mesh moved by a rigid transform (4, 4)."""
        R = T_a_b[:3, :3].astype(np.float32)
        moved = self.vertices_m @ R.T + T_a_b[:3, 3].astype(np.float32)
        return replace(self, vertices_m=moved, normals=self.normals @ R.T)

    def as_instance(self, instance: int) -> Mesh:
        """Return the mesh with all faces assigned to one instance."""
        return replace(self, instance=np.full(len(self.faces), instance, np.uint8))


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Return the union of meshes."""
    starts = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uv for m in meshes]),
        np.concatenate(
            [m.faces + int(n) for m, n in zip(meshes, starts, strict=True)], dtype=np.int32
        ),
        np.concatenate([m.texture for m in meshes]),
        np.concatenate([m.instance for m in meshes]),
    )


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _tangent(points: FloatArray, axis: int, closed: bool) -> FloatArray:
    if not closed:
        return np.asarray(np.gradient(points, axis=axis))
    ring = points[:, :-1] if axis == 1 else points[:-1]
    step = np.roll(ring, -1, axis) - np.roll(ring, 1, axis)
    return np.concatenate([step, step.take([0], axis)], axis)


def grid(points: FloatArray, uv: FloatArray, surface: Surface, closed: bool = False) -> Mesh:
    """Return the mesh of a grid of points; its outward normal is d/dcolumn x d/drow.

    Args:
        points: (rows, columns, 3) vertices.
        uv: (rows, columns, 2) texture coordinates.
        surface: Texture of the mesh.
        closed: Whether the last column repeats the first one, as around a tube.
    """
    normals = _unit(np.cross(_tangent(points, 1, closed), _tangent(points, 0, False)))
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return Mesh(
        points.reshape(-1, 3).astype(np.float32),
        normals.reshape(-1, 3).astype(np.float32),
        uv.reshape(-1, 2).astype(np.float32),
        faces,
        np.full(len(faces), surface.texture, np.int16),
        np.zeros(len(faces), np.uint8),
    )


def quad(
    origin: Vector,
    edge_u: Vector,
    edge_v: Vector,
    surface: Surface,
    cell_m: float = CELL_M,
) -> Mesh:
    """Return a flat patch; seen from outside, u points right and v (along edge_v) down."""
    o, eu, ev = (np.asarray(x, float) for x in (origin, edge_u, edge_v))
    lengths = np.linalg.norm(eu), np.linalg.norm(ev)
    counts = [max(1, int(np.ceil(length / cell_m))) + 1 for length in lengths]
    s, t = np.meshgrid(np.linspace(0, 1, counts[0]), np.linspace(0, 1, counts[1]))
    points = o + s[..., None] * eu + t[..., None] * ev
    repeats = (1.0, 1.0) if surface.size_m is None else np.divide(lengths, surface.size_m)
    return _flipped(grid(points, np.stack([s * repeats[0], t * repeats[1]], -1), surface))


def _flipped(mesh: Mesh) -> Mesh:
    return replace(mesh, normals=-mesh.normals, faces=mesh.faces[:, ::-1].copy())


def box(
    low: Sequence[float],
    high: Sequence[float],
    surface: Surface,
    faces: Mapping[str, Surface] | None = None,
    omit: Sequence[str] = (),
) -> Mesh:
    """Return an axis-aligned box; `faces` gives sides (left, right, front = -y, ...) a surface."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    sides = {
        'left': ((x0, y1, z1), (0, -dy, 0), (0, 0, -dz)),
        'right': ((x1, y0, z1), (0, dy, 0), (0, 0, -dz)),
        'front': ((x0, y0, z1), (dx, 0, 0), (0, 0, -dz)),
        'back': ((x1, y1, z1), (-dx, 0, 0), (0, 0, -dz)),
        'bottom': ((x0, y0, z0), (dx, 0, 0), (0, dy, 0)),
        'top': ((x0, y1, z1), (dx, 0, 0), (0, -dy, 0)),
    }
    own = faces or {}
    return merged([quad(*sides[f], own.get(f, surface)) for f in _FACES if f not in omit])


def tube(
    centers_m: FloatArray,
    radii_m: FloatArray,
    side: Vector,
    surface: Surface,
    around: int = 14,
) -> Mesh:
    """Return a tube with elliptic cross sections and closed ends along a curve.

    Args:
        centers_m: (N, 3) center line.
        radii_m: (N, 2) half axes along `side` and across it.
        side: Direction of angle 0; must not be parallel to the curve.
        surface: Texture; u points around the tube, v along it.
        around: Number of vertices around the tube.
    """
    along = _unit(np.gradient(centers_m, axis=0))
    s = np.asarray(side, float)
    s = _unit(s - (along @ s)[:, None] * along)
    across = np.cross(along, s)
    centers, radii = _with_ends(centers_m), _with_ends(radii_m)
    radii[[0, -1]] = 1e-4
    s, across = _with_ends(s), _with_ends(across)
    angle = np.linspace(0, 2 * np.pi, around + 1)
    ring = np.cos(angle)[None, :, None] * (radii[:, :1] * s)[:, None]
    ring = ring + np.sin(angle)[None, :, None] * (radii[:, 1:] * across)[:, None]
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(centers, axis=0), axis=1))])
    girth = np.pi * float(radii_m.sum(1).max())
    size = surface.size_m or (girth, max(float(length[-1]), 1e-6))
    u, v = np.meshgrid(angle / (2 * np.pi) * max(1, round(girth / size[0])), length / size[1])
    return grid(centers[:, None] + ring, np.stack([u, v], -1), surface, closed=True)


def _with_ends(rows: FloatArray) -> FloatArray:
    return np.concatenate([rows[:1], rows, rows[-1:]])


def cylinder(
    base: Sequence[float], height_m: float, radius_m: float, surface: Surface, around: int = 18
) -> Mesh:
    """Return an upright cylinder with closed ends."""
    steps = max(2, int(np.ceil(height_m / CELL_M)) + 1)
    centers = np.asarray(base, float) + np.linspace(0, height_m, steps)[:, None] * [0, 0, 1.0]
    return tube(centers, np.full((steps, 2), radius_m), (1, 0, 0), surface, around)


def ellipsoid(
    center: Vector,
    radii_m: Vector,
    surface: Surface,
    rows: int = 12,
    columns: int = 18,
    latitude: tuple[float, float] = (-np.pi / 2, np.pi / 2),
) -> Mesh:
    """Return an ellipsoid or a zone of it; u points around z from -y, v from the top down."""
    theta = np.linspace(latitude[1], latitude[0], rows)[:, None]
    phi = np.linspace(-1.5 * np.pi, 0.5 * np.pi, columns)[None]
    unit = np.stack(
        [np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta) + 0 * phi], -1
    )
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    uv = np.stack([u, v], -1)
    if surface.size_m is not None:
        uv = uv * [
            round(2 * np.pi * radii_m[0] / surface.size_m[0]) or 1,
            np.pi * radii_m[2] / surface.size_m[1],
        ]
    mesh = _flipped(grid(np.asarray(center, float) + unit * radii_m, uv, surface, closed=True))
    outwards = _unit(unit / np.asarray(radii_m)).reshape(-1, 3)
    return replace(mesh, normals=outwards.astype(np.float32))
