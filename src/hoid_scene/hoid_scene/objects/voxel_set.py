"""The voxels of one object, with the evidence for each.

A look is an image in which the object may be seen.
"""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from hoid_native import merged_voxels, solid_voxels, voxel_keys, voxels_of
from hoid_native.results import Voxels

VOXEL_M = 0.025  # side of a voxel, as in the dense map
BITS = 10  # bits of a key per axis: 1024 voxels, +-12.8 m
NUM_KEYS = 1 << (3 * BITS)
_MAX_VOXELS = 6000  # chosen: a couch has 5000; 140 kB
_MAX_COUNT = 60.0  # chosen: largest sum of hits and misses, so that a change takes effect soon
# A voxel is solid if it was hit in at least so many looks, and in at least this share of the looks
# that hit or missed it (not tuned).
_SOLID_HITS, _SOLID_SHARE = 3.0, 0.4


class VoxelSet:
    """Voxels sorted by key, in the object frame.

    Hits and misses of a voxel are scaled down together when their sum exceeds 60. Beyond 6000
    voxels, the voxels with fewest hits are dropped.

    Attributes:
        keys: (N,) ascending keys, see `hoid_native.voxel_keys`.
        means_m: (N, 3) mean of the points measured in each voxel.
        readings: (N,) number of these points.
        hits: (N,) number of looks that measured the surface of the object in the voxel.
        misses: (N,) number of looks that showed that the voxel does not belong to the object.
    """

    def __init__(self) -> None:
        self.keys: IntArray = np.empty(0, np.int64)
        self.means_m: FloatArray = np.empty((0, 3))
        self.readings: Float32Array = np.empty(0, np.float32)
        self.hits: Float32Array = np.empty(0, np.float32)
        self.misses: Float32Array = np.empty(0, np.float32)

    def __len__(self) -> int:
        return len(self.keys)

    def add_points(self, points_m: FloatArray) -> None:
        """Count one look that measured points (M, 3) of the object, in the object frame."""
        self._add(voxels_of(points_m, VOXEL_M, BITS))

    def merge(self, other: VoxelSet) -> None:
        self._add(other.arrays())

    def arrays(self) -> Voxels:
        return Voxels(self.keys, self.means_m, self.readings, self.hits, self.misses)

    def _add(self, others: Voxels) -> None:
        merged = merged_voxels(self.arrays(), others, _MAX_COUNT, _MAX_VOXELS)
        self.keys, self.means_m, self.readings, self.hits, self.misses = merged

    def count_misses(self, rows: IntArray) -> None:
        """Count an image as evidence that the voxels `rows` (M,) do not belong to the object."""
        self.misses[rows] += 1

    def solid(self, num_looks: int, cell_m: float) -> BoolArray:
        """Return the (N,) mask of the object's voxels, with hits counted in cells of `cell_m`."""
        least = min(_SOLID_HITS, math.ceil(num_looks / 3))
        cells_m = cell_m if cell_m > VOXEL_M else None
        return solid_voxels(self.arrays(), least, _SOLID_SHARE, cells_m, BITS)

    def moved(self, T_new_old: FloatArray) -> VoxelSet:
        """Return the voxels in another frame.

        Where several voxels fall into one, their largest hits and misses are kept. Voxels beyond
        12.8 m from the origin of the other frame along an axis are left out.
        """
        out = VoxelSet()
        points = self.means_m @ T_new_old[:3, :3].T + T_new_old[:3, 3]
        key = voxel_keys(points, VOXEL_M, BITS)
        kept = np.flatnonzero(key >= 0)
        keys, index = np.unique(key[kept], return_inverse=True)
        weight = self.readings[kept].astype(np.float64)
        total = np.bincount(index, weight, len(keys))
        out.keys, out.readings = keys, total.astype(np.float32)
        out.means_m = np.empty((len(keys), 3))
        for axis in range(3):
            summed = np.bincount(index, weight * points[kept, axis], len(keys))
            out.means_m[:, axis] = summed / total
        out.hits, out.misses = np.zeros(len(keys), np.float32), np.zeros(len(keys), np.float32)
        np.maximum.at(out.hits, index, self.hits[kept])
        np.maximum.at(out.misses, index, self.misses[kept])
        return out


def trimmed_box(points_m: FloatArray, outer: float) -> tuple[FloatArray, FloatArray]:
    """Return the two corners (3,) of points (N, 3), without the ratio `outer` on each side."""
    last = len(points_m) - 1
    ends = [round(outer * last), round((1 - outer) * last)]
    low, high = np.partition(points_m, ends, axis=0)[ends]
    return low, high
