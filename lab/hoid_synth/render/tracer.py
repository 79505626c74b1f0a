"""Intersection of rays with triangle meshes by Embree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from hoid_common.values import BoolArray, Float32Array, FloatArray

_FAR = np.float32(1e8)


@dataclass(frozen=True, eq=False)
class Hits:
    """First intersections of rays; `t` is in multiples of the given direction."""

    t: Float32Array  # (N,), inf without a hit
    face: NDArray[np.int32]  # (N,), -1 without a hit
    barycentric: Float32Array  # (N, 2) weights of the second and third vertex of the face


class Tracer:
    """Intersects rays with one triangle mesh."""

    def __init__(self, vertices_m: Float32Array, faces: NDArray[np.int32]) -> None:
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(
            self._scene, np.ascontiguousarray(vertices_m), np.ascontiguousarray(faces)
        )

    def first_hits(self, origin_m: FloatArray | Float32Array, directions: Float32Array) -> Hits:
        """Return the first hits of rays (N, 3) from a common origin (3,) or origins (N, 3)."""
        origins = np.empty_like(directions)
        origins[:] = origin_m
        out = self._scene.run(origins, directions, output=True)
        face = out['primID']
        missed = face < 0
        t = out['tfar']
        t[missed] = np.inf
        return Hits(t, face, np.stack([out['u'], out['v']], -1))

    def distance(
        self, origins_m: Float32Array, directions: Float32Array, reach_m: float
    ) -> Float32Array:
        """Return the free distance (N,) along unit rays (N, 3), at most `reach_m`."""
        t = self._scene.run(origins_m, np.ascontiguousarray(directions), query='DISTANCE')
        return np.minimum(np.asarray(t, np.float32), np.float32(reach_m))

    def occluded(self, origins_m: Float32Array, offsets_m: Float32Array) -> BoolArray:
        """Return whether (N,) the segments from origins (N, 3) by offsets (N, 3) are blocked."""
        limit = np.full(len(origins_m), 1.0, np.float32)
        hit = self._scene.run(origins_m, np.ascontiguousarray(offsets_m), limit, query='OCCLUDED')
        return np.asarray(hit) >= 0
