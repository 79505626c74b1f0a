"""The voxels of one object, with the evidence for each.

A look is an image in which the object may be seen.
"""

from __future__ import annotations

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray

VOXEL_M = 0.025  # side of a voxel, as in the dense map
_BITS, _OFFSET = 10, 512  # cells of each axis in a key: +-12.8 m
NUM_KEYS = 1 << (3 * _BITS)
_MAX_VOXELS = 6000  # chosen: a couch has 5000; 140 kB
_MAX_COUNT = 60.0  # chosen: largest sum of hits and misses, so that a change takes effect soon
# A voxel is solid if it was hit in at least so many looks, and in at least this share of the looks
# that hit or missed it (not tuned).
_SOLID_HITS, _SOLID_SHARE = 3.0, 0.4
# Assumed thickness of an object whose back was never seen; its width if that is smaller (as in
# `object_sighting`).
_HIDDEN_M = 0.15
# The mean of the unit viewing directions of an object is long if all are alike: from this length
# on, only one side of the object was seen.
_ONE_SIDED = 0.9


class VoxelSet:
    """Voxels sorted by key, in the object frame.

    Hits and misses of a voxel are scaled down together when their sum exceeds 60. Of more than
    6000 voxels, those with fewest hits are dropped.

    Attributes:
        keys: (N,) ascending keys, see `keys_of`.
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
        """Count one look that measured points (M, 3) of the object, in the object frame.

        Points beyond 12.8 m from the origin along an axis are ignored.
        """
        key = keys_of(points_m)
        inside = key >= 0
        keys, index = np.unique(key[inside], return_inverse=True)
        num = np.bincount(index, minlength=len(keys))
        means = (
            np.stack(
                [np.bincount(index, axis, len(keys)) / num for axis in points_m[inside].T], axis=1
            )
            if len(keys)
            else np.empty((0, 3))
        )
        other = VoxelSet()
        other.keys, other.means_m = keys, means
        other.readings = num.astype(np.float32)
        other.hits = np.ones(len(keys), np.float32)
        other.misses = np.zeros(len(keys), np.float32)
        self.merge(other)

    def merge(self, other: VoxelSet) -> None:
        """Add the evidence of other voxels of the same frame."""
        keys = np.union1d(self.keys, other.keys)
        own, theirs = np.searchsorted(keys, self.keys), np.searchsorted(keys, other.keys)
        sums, readings = np.zeros((len(keys), 3)), np.zeros(len(keys), np.float32)
        hits, misses = np.zeros_like(readings), np.zeros_like(readings)
        for rows, part in ((own, self), (theirs, other)):
            sums[rows] += part.means_m * part.readings[:, None]
            readings[rows] += part.readings
            hits[rows] += part.hits
            misses[rows] += part.misses
        self.keys, self.means_m = keys, sums / readings[:, None]
        self.readings, self.hits, self.misses = readings, hits, misses
        self._limit()

    def count_misses(self, rows: IntArray) -> None:
        """Count an image as evidence that the voxels `rows` (M,) do not belong to the object."""
        self.misses[rows] += 1

    def solid(self, num_looks: int, cell_m: float) -> BoolArray:
        """Return the (N,) mask of the voxels that belong to the object.

        Args:
            num_looks: Number of looks at the object so far; if these are few, a voxel needs
                fewer hits.
            cell_m: Side of the cells whose voxels are counted together, because the noise of
                depth spreads the hits of a distant surface over several voxels. Cells smaller than
                a voxel have no effect.
        """
        least = min(_SOLID_HITS, np.ceil(num_looks / 3))
        hits = self.hits.astype(np.float64)
        seen = hits + self.misses
        if cell_m > VOXEL_M:
            cells = keys_of(self.means_m * (VOXEL_M / cell_m))
            _, index = np.unique(cells, return_inverse=True)
            hits = np.bincount(index, hits)[index].astype(np.float64)
            seen = np.bincount(index, seen)[index].astype(np.float64)
        return np.asarray((hits >= least) & (hits >= _SOLID_SHARE * seen))

    def moved(self, T_new_old: FloatArray) -> VoxelSet:
        """Return the voxels in another frame.

        Where several voxels fall into one, their largest hits and misses are kept. Voxels beyond
        12.8 m from the origin of the other frame along an axis are left out.

        Args:
            T_new_old: (4, 4) pose of the present frame in the other one.
        """
        out = VoxelSet()
        points = self.means_m @ T_new_old[:3, :3].T + T_new_old[:3, 3]
        key = keys_of(points)
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

    def _limit(self) -> None:
        """Limit the evidence of each voxel, and the number of voxels to those with most hits."""
        seen = self.hits + self.misses
        scale = np.minimum(1.0, _MAX_COUNT / np.maximum(seen, 1)).astype(np.float32)
        self.hits *= scale
        self.misses *= scale
        if len(self.keys) > _MAX_VOXELS:
            kept = np.sort(np.argsort(self.hits, kind='stable')[-_MAX_VOXELS:])
            self.keys, self.means_m = self.keys[kept], self.means_m[kept]
            self.readings = self.readings[kept]
            self.hits, self.misses = self.hits[kept], self.misses[kept]


def keys_of(points_m: FloatArray) -> IntArray:
    """Return the (N,) keys of the voxels of points (N, 3) of the object frame.

    The key is -1 for a point beyond 12.8 m from the origin along an axis.
    """
    cell = np.floor(points_m / VOXEL_M).astype(np.int64) + _OFFSET
    inside = ((cell >= 0) & (cell < 1 << _BITS)).all(axis=1)
    key = (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]
    return np.where(inside, key, -1)


def extend_back(low_m: FloatArray, high_m: FloatArray, direction: FloatArray) -> None:
    """Extend the box of voxels that were seen from one side only, away from the camera.

    Args:
        low_m: (3,) lowest corner, which is changed.
        high_m: (3,) highest corner, which is changed.
        direction: (2,) x and y of the mean of the unit vectors from the camera to the object.
    """
    if np.linalg.norm(direction) < _ONE_SIDED:
        return
    axis = int(np.argmax(np.abs(direction)))
    across = 1 - axis
    thickness_m = min(float(high_m[across] - low_m[across]), _HIDDEN_M)
    hidden_m = thickness_m - (high_m[axis] - low_m[axis])
    if hidden_m > 0 and direction[axis] > 0:
        high_m[axis] += hidden_m
    elif hidden_m > 0:
        low_m[axis] -= hidden_m
