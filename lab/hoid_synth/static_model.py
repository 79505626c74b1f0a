"""Distances of points to the static surfaces of a stage."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Float32Array, FloatArray, IntArray
from hoid_synth.acting.stage import Stage

_REACH_M = 0.06
_PAIRS_PER_CHUNK = 2_000_000


class StaticModel:
    """Distances of points to the surfaces that are static during the whole recording.

    Args:
        stage: The stage, whose static mesh is used.
        reach_m: Upper limit of the distances.
    """

    def __init__(self, stage: Stage, reach_m: float = _REACH_M) -> None:
        self._reach_m = reach_m
        mesh = stage.static_mesh
        self._corners = mesh.vertices_m[mesh.faces].astype(float)  # (F, 3, 3)
        self._low = self._corners.min((0, 1)) - 2 * reach_m
        span = self._corners.max((0, 1)) + 2 * reach_m - self._low
        self._shape = np.ceil(span / reach_m).astype(int)
        cells, faces = self._touched_cells()
        order = np.argsort(cells, kind='stable')
        self._faces = faces[order]
        self._starts = np.searchsorted(cells[order], np.arange(int(self._shape.prod()) + 1))

    def distance_m(self, points_m: FloatArray | Float32Array) -> FloatArray:
        """Return distances (N,) of world points (N, 3), limited to `reach_m`."""
        points = np.asarray(points_m, float)
        out = np.full(len(points), self._reach_m)
        cell = np.floor((points - self._low) / self._reach_m).astype(int)
        inside = np.flatnonzero(((cell >= 0) & (cell < self._shape)).all(1))
        flat = np.ravel_multi_index(tuple(cell[inside].T), tuple(self._shape))
        count = self._starts[flat + 1] - self._starts[flat]
        splits = np.searchsorted(np.cumsum(count), np.arange(0, count.sum(), _PAIRS_PER_CHUNK)[1:])
        for part in np.split(np.arange(len(inside)), splits):
            which, face = self._pairs(flat[part], count[part])
            square = _squared_distance(points[inside[part[which]]], self._corners[face])
            np.minimum.at(out, inside[part[which]], np.sqrt(square))
        return out

    def _pairs(self, cells: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
        """Return the indices of point and face of every pair to compare."""
        which = np.repeat(np.arange(len(cells)), count)
        first = np.repeat(self._starts[cells] - np.cumsum(count) + count, count)
        return which, self._faces[first + np.arange(len(which))]

    def _touched_cells(self) -> tuple[IntArray, IntArray]:
        """Return the pairs of a cell and a face that is within reach of points in the cell."""
        low = np.floor((self._corners.min(1) - self._reach_m - self._low) / self._reach_m)
        high = np.floor((self._corners.max(1) + self._reach_m - self._low) / self._reach_m)
        low, size = low.astype(int), (high - low).astype(int) + 1
        count = size.prod(1)
        face = np.repeat(np.arange(len(low)), count)
        k = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
        nx, ny = size[face, 0], size[face, 1]
        offset = np.stack([k % nx, k // nx % ny, k // (nx * ny)], -1)
        cells = np.ravel_multi_index(tuple((low[face] + offset).T), tuple(self._shape))
        return np.asarray(cells), face


def _squared_distance(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return (K,) squared distances of points (K, 3) to triangles (K, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    inside = np.ones(len(points), bool)
    best = np.full(len(points), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        edge, way = q - p, points - p
        inside &= np.einsum('ij,ij->i', np.cross(edge, way), normal) >= 0
        length = np.maximum(np.einsum('ij,ij->i', edge, edge), 1e-18)
        s = np.clip(np.einsum('ij,ij->i', way, edge) / length, 0, 1)
        gap = way - s[:, None] * edge
        best = np.minimum(best, np.einsum('ij,ij->i', gap, gap))
    square = np.maximum(np.einsum('ij,ij->i', normal, normal), 1e-18)
    plane = np.einsum('ij,ij->i', points - a, normal) ** 2 / square
    return np.asarray(np.where(inside, plane, best))
