"""Light at mesh vertices: lamps with soft shadows, and ambient light with occlusion."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array
from hoid_synth.mesh import Mesh
from hoid_synth.render.tracer import Tracer
from hoid_synth.room.world import Lamp

AMBIENT = 0.42
CEILING_POINTS = 4
_OCCLUSION_RAYS = 20
_OCCLUSION_REACH_M = 0.9
_LIFT_M = 0.012
_SOFT_M2 = 1.2  # limits the light near a lamp
_REACH_M = 14.0  # more than the length of two rooms; the light of a lamp is below 2 % there


def _hemisphere(count: int) -> Float32Array:
    """Return cosine-weighted unit vectors (N, 3) around +z on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    radius, angle = np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
    z = np.sqrt(1 - radius**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).astype(np.float32)


def _frames(normals: Float32Array) -> Float32Array:
    """Return (N, 3, 3) with columns tangent, bitangent, normal (Duff et al., 2017)."""
    x, y, z = normals.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    bitangent = np.stack([b, sign + y * y * a, -y], -1)
    return np.stack([tangent, bitangent, normals], -1).astype(np.float32)


def openness(tracer: Tracer, mesh: Mesh) -> Float32Array:
    """Return the unoccluded share (V,) of the hemisphere at each vertex."""
    origin = mesh.vertices_m + _LIFT_M * mesh.normals
    frames = _frames(mesh.normals)
    total = np.zeros(len(origin), np.float32)
    for direction in _hemisphere(_OCCLUSION_RAYS):
        distance = tracer.distance(origin, frames @ direction, _OCCLUSION_REACH_M)
        total += np.minimum(distance / _OCCLUSION_REACH_M, 1)
    return np.asarray(total / _OCCLUSION_RAYS, np.float32)


def direct(
    tracer: Tracer, vertices_m: Float32Array, normals: Float32Array, lamps: tuple[Lamp, ...]
) -> Float32Array:
    """Return the direct light (V,) of the lamps."""
    origin = vertices_m + _LIFT_M * normals
    total = np.zeros(len(origin), np.float32)
    for lamp in lamps:
        for point in lamp.points_m.astype(np.float32):
            way = point - origin
            square = np.einsum('ij,ij->i', way, way)
            cosine = np.einsum('ij,ij->i', way, normals) / np.sqrt(square)
            lit = (cosine > 0) & (square < _REACH_M**2)
            visible = np.zeros(len(origin), np.float32)
            visible[lit] = ~tracer.occluded(origin[lit], way[lit])
            share = lamp.strength / len(lamp.points_m) / (square + _SOFT_M2)
            total += visible * np.maximum(cosine, 0) * share
    return total


def bake(tracer: Tracer, mesh: Mesh, lamps: tuple[Lamp, ...]) -> Float32Array:
    """Return the light (V,) of a static mesh."""
    ambient = AMBIENT * (0.25 + 0.75 * openness(tracer, mesh))
    return np.asarray(direct(tracer, mesh.vertices_m, mesh.normals, lamps) + ambient, np.float32)


def light_moving(tracer: Tracer, mesh: Mesh, lamps: tuple[Lamp, ...]) -> Float32Array:
    """Return the light (V,) of a moving mesh, with ambient light from above and no occlusion."""
    ambient = AMBIENT * (0.62 + 0.3 * mesh.normals[:, 2])
    return direct(tracer, mesh.vertices_m, mesh.normals, lamps) + ambient
