"""Colors of ray hits, by texture coordinates and light that are affine over each triangle."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array
from hoid_synth.mesh import Mesh
from hoid_synth.render.tracer import Hits
from hoid_synth.texture.atlas import LEVELS, TextureAtlas

# Value at vertex 0, and differences to vertices 1 and 2.
_U, _V, _LIGHT = slice(0, 3), slice(3, 6), slice(6, 9)
_PLACE = slice(9, 13)
_DENSITY, _GLOW = 13, 14
_COLUMNS = 16
_CHUNK = 1 << 15


def face_table(mesh: Mesh, light: Float32Array, atlas: TextureAtlas) -> Float32Array:
    """Return a table with one row per face of the values that shading needs."""
    table = np.zeros((len(mesh.faces), _COLUMNS), np.float32)
    place = atlas.places[mesh.texture]
    uv = mesh.uv[mesh.faces] * place[:, None, 2:]  # in texels of level 0
    for columns, axis in ((_U, 0), (_V, 1)):
        table[:, columns] = _affine(uv[..., axis])
    du, dv = table[:, 1:3], table[:, 4:6]
    texels = np.abs(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0])
    table[:, _DENSITY] = texels / np.maximum(np.linalg.norm(face_vectors(mesh), axis=1), 1e-12)
    table[:, _PLACE] = place
    table[:, _GLOW] = atlas.glow[mesh.texture]
    set_light(table, mesh, light)
    return table


def face_vectors(mesh: Mesh) -> Float32Array:
    """Return face normals (F, 3) with the length of twice the area of the face."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a).astype(np.float32)


def face_normals(mesh: Mesh) -> Float32Array:
    """Return unit face normals (F, 3)."""
    out = face_vectors(mesh)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.maximum(length, np.float32(1e-12)))


def set_light(table: Float32Array, mesh: Mesh, light: Float32Array) -> None:
    """Set the light of the vertices (V,) in the table of a mesh."""
    table[:, _LIGHT] = _affine(light[mesh.faces])


def _affine(corners: Float32Array) -> Float32Array:
    out = np.empty_like(corners)
    out[:, 0] = corners[:, 0]
    out[:, 1:] = corners[:, 1:] - corners[:, :1]
    return out


def shade(
    table: Float32Array,
    hits: Hits,
    footprint_m2: Float32Array,
    atlas: TextureAtlas,
    shadow: Float32Array,
    exposure: float,
) -> Float32Array:
    """Return BGR colors (N, 3) of 0 to 255, with a square-root tone curve.

    Args:
        table: Table of all faces.
        hits: N hits; every ray must hit a face.
        footprint_m2: (N,) surface area seen by one pixel.
        atlas: All textures.
        shadow: (N,) factor of the light.
        exposure: Factor of all light.
    """
    color = np.empty((len(hits.face), 3), np.float32)
    for start in range(0, len(color), _CHUNK):  # chunks that fit in the cache take half the time
        k = slice(start, start + _CHUNK)
        rows = np.take(table, hits.face[k], axis=0)
        color[k] = _shaded(rows, hits.barycentric[k], footprint_m2[k], atlas, shadow[k], exposure)
    return color


def _shaded(
    rows: Float32Array,
    barycentric: Float32Array,
    footprint_m2: Float32Array,
    atlas: TextureAtlas,
    shadow: Float32Array,
    exposure: float,
) -> Float32Array:
    u, v = barycentric.T
    x = rows[:, 0] + u * rows[:, 1] + v * rows[:, 2]
    y = rows[:, 3] + u * rows[:, 4] + v * rows[:, 5]
    light = rows[:, 6] + u * rows[:, 7] + v * rows[:, 8]
    width, height = rows[:, 11], rows[:, 12]
    xy = np.empty((len(x), 2), np.float32)
    xy[:, 0] = rows[:, 9] + x - np.floor(x / width) * width
    xy[:, 1] = rows[:, 10] + y - np.floor(y / height) * height
    level = 0.5 * np.log2(np.maximum(rows[:, _DENSITY] * footprint_m2, 1e-6))
    glow = rows[:, _GLOW]
    light = exposure * (light * shadow * (1 - glow) + glow)
    color = atlas.sample(xy, np.clip(level, 0, LEVELS - 1.001).astype(np.float32))
    color *= np.sqrt(np.maximum(light, 0))[:, None]
    return color
