"""From ray hits to colours: texture coordinates and light, affine over each triangle."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array
from hoid_synth.mesh import Mesh
from hoid_synth.render.tracer import Hits
from hoid_synth.texture.atlas import LEVELS, TextureAtlas

_U, _V, _LIGHT = slice(0, 3), slice(3, 6), slice(6, 9)  # value at vertex 0, its steps to 1 and 2
_PLACE = slice(9, 13)
_DENSITY, _GLOW = 13, 14
_COLUMNS = 16
_CHUNK = 1 << 15


def face_table(mesh: Mesh, light: Float32Array, atlas: TextureAtlas) -> Float32Array:
    """Return one row per face with all that shading needs."""
    table = np.zeros((len(mesh.faces), _COLUMNS), np.float32)
    place = atlas.places[mesh.texture]
    uv = mesh.uv[mesh.faces] * place[:, None, 2:]  # level-0 texels
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
    """Return (F, 3) face normals, twice the face's area long."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a).astype(np.float32)


def face_normals(mesh: Mesh) -> Float32Array:
    """Return (F, 3) unit face normals."""
    out = face_vectors(mesh)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.maximum(length, np.float32(1e-12)))


def set_light(table: Float32Array, mesh: Mesh, light: Float32Array) -> None:
    """Write the light of a mesh's vertices into its table."""
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
    """Return colours (N, 3), 0..255 in a square-root tone curve.

    Args:
        table: rows of all faces.
        hits: N of them, none missed.
        footprint_m2: (N,) area of surface in one pixel.
        atlas: textures.
        shadow: (N,) factor on the baked light.
        exposure: factor on all light.
    """
    colour = np.empty((len(hits.face), 3), np.float32)
    for start in range(0, len(colour), _CHUNK):  # what fits the cache takes half the time
        k = slice(start, start + _CHUNK)
        rows = np.take(table, hits.face[k], axis=0)
        colour[k] = _shaded(rows, hits.barycentric[k], footprint_m2[k], atlas, shadow[k], exposure)
    return colour


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
    colour = atlas.sample(xy, np.clip(level, 0, LEVELS - 1.001).astype(np.float32))
    colour *= np.sqrt(np.maximum(light, 0))[:, None]
    return colour
