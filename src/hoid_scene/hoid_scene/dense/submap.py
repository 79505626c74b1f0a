"""A submap of the dense map: the voxels of one cube of space, in a frame moving with a keyframe.

Submaps follow Voxgraph (Reijgwart et al., RA-L 2020): a correction of the map moves each one
rigidly with its anchor keyframe, so that no evidence is lost. Where cubes overlap, the oldest
submap gets the surface of an image, so that no surface is stored twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import Surface
from hoid_scene.place import Place

SIDE = 64  # voxels along an edge of the cube; chosen: an image shows about 20 cubes of 1.6 m
# Voxels by which a cube extends into its neighbors: after a correction the cubes no longer meet
# exactly, and thin gaps between them would fill with small new submaps. Not tuned.
_OVERLAP = 4
SPAN = SIDE + 2 * _OVERLAP
_MAX_HITS = 30.0  # chosen: largest number of hits, so that a change is seen within seconds
_CARVE_WEIGHT = 3.0  # an image that sees through a voxel cancels 3 that measured it; not tuned
_W, _HITS, _VIEWS, _NUM_COLUMNS = 6, 7, 8, 9  # columns of `Submap.values` after w*xyz and w*bgr


class Evidence(NamedTuple):
    """Flags of the N voxels of a submap, as one image observes them."""

    is_carved: BoolArray  # (N,) the image sees through it
    is_observed: BoolArray  # (N,) the image measures static surface near it
    # (N,) The image measures static surface within half a voxel of it plus the noise of depth.
    is_confirmed: BoolArray


class ColoredCloud(NamedTuple):
    """Points with color."""

    points_m: Float32Array  # (N, 3), map frame
    colors_bgr: ByteArray  # (N, 3)


class Submap:
    """The voxels of one cube of space, in arrays sorted by key.

    Its frame, `place`, has its origin at the corner of the cube with the smallest coordinates.
    """

    def __init__(self, place: Place, config: DenseConfig) -> None:
        self._config, self.place = config, place
        self.keys = np.empty(0, np.int32)
        # Columns: the sums of w*x, w*y, w*z, w*b, w*g, w*r and w; the number of images that
        # confirmed the voxel, less _CARVE_WEIGHT for each image that saw through it; and the
        # number of images that measured static surface near it. Both numbers are limited to
        # _MAX_HITS.
        self.values = np.empty((0, _NUM_COLUMNS), np.float32)
        # For each column of 2 x 2 voxels, bit k: it is free in the k-th step of height above the
        # floor (`free_space.py`).
        self.free_above = np.zeros((SPAN // 2, SPAN // 2), np.uint16)
        # T_submap_camera of each stored image that had the cube in view, by its slot.
        self.poses: dict[int, FloatArray] = {}
        self.fused: set[int] = set()  # slots of images that changed voxels
        self.marked: set[int] = set()  # slots of images that `free_space.py` has processed
        self.num_fused = 0  # images that changed voxels, including images no longer stored
        # Whether the submap must be rebuilt: its images have moved relative to it by more than a
        # limit, and enough of them are still stored (`dense_map.py`).
        self.is_bent = False
        self.revision = 0  # increases with each change of voxels, free space or pose
        # Keys, values and `free_above` before any stored image was fused: from a loaded map, or
        # empty. A rebuild starts with them.
        self._base = self.keys, self.values, self.free_above.copy()

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def radius_m(self) -> float:
        return float(0.5 * np.sqrt(3) * SPAN * self._config.voxel_m)

    @property
    def center_m(self) -> FloatArray:
        """Return the center (3,) of the cube, in the submap's frame."""
        return np.full(3, 0.5 * SIDE * self._config.voxel_m)

    @property
    def is_in_memory(self) -> bool:
        """Return whether the voxels are in memory and not in a file."""
        return self.values.flags.writeable

    @property
    def T_map_submap(self) -> FloatArray:  # noqa: N802 - a transform's name
        return self.place.T_map_place

    @property
    def center_map_m(self) -> FloatArray:
        return self.T_map_submap[:3, :3] @ self.center_m + self.T_map_submap[:3, 3]

    def follow(self, before: KeyframePoses, after: KeyframePoses) -> bool:
        """Move the submap with its anchor; return False if no keyframe of its map remains."""
        T_before = self.T_map_submap
        is_kept = self.place.follow(before, after)
        self.revision += self.T_map_submap is not T_before
        return is_kept

    def points_m(self) -> Float32Array:
        """Return the (N, 3) mean points of the voxels, in the submap's frame."""
        return np.asarray(self.values[:, :3] / self.values[:, _W : _W + 1])

    def is_shown(self) -> BoolArray:
        """Return the (N,) mask of the voxels that enough images agree on."""
        hits = self.values[:, _HITS]
        agreed = hits >= self._config.min_hit_share * self.values[:, _VIEWS]
        return np.asarray(agreed & (hits >= self._config.min_views))

    def cloud(self) -> ColoredCloud:
        sums = self.values[self.is_shown()]
        mean = sums[:, :6] / sums[:, _W : _W + 1]
        points = transform(self.T_map_submap, mean[:, :3])
        return ColoredCloud(points, mean[:, 3:].round().astype(np.uint8))

    def contains(self, points_m: FloatArray) -> BoolArray:
        """Return the (N,) mask of points (N, 3), submap frame, inside the cube and its overlap."""
        x, y, z = np.floor(points_m / self._config.voxel_m).T
        low, end = -_OVERLAP, SIDE + _OVERLAP
        inside = (x >= low) & (x < end) & (y >= low) & (y < end) & (z >= low) & (z < end)
        return np.asarray(inside)

    def update(self, evidence: Evidence, surface: Surface | None) -> None:
        """Update the voxels with an image: carve those that it sees through, add its surface."""
        self._load()
        self.revision += 1
        hits = self.values[:, _HITS]  # a view into the array
        hits[evidence.is_carved] -= _CARVE_WEIGHT
        self.values[evidence.is_observed, _VIEWS] += 1
        confirmed = evidence.is_confirmed
        fresh, fresh_values = np.empty(0, np.int32), np.empty((0, _NUM_COLUMNS), np.float32)
        if surface is not None:
            keys, added = self._sums_of(surface)
            at, known = _find(self.keys, keys)
            self.values[at[known], : _W + 1] += added[known, : _W + 1]
            confirmed = confirmed.copy()
            confirmed[at[known]] = True
            fresh, fresh_values = keys[~known], added[~known]
        hits[confirmed] = np.minimum(np.maximum(hits[confirmed], 0) + 1, _MAX_HITS)
        np.minimum(self.values[:, _VIEWS], _MAX_HITS, out=self.values[:, _VIEWS])
        keep = hits > 0
        if len(fresh) == 0 and keep.all():
            return
        keys = np.concatenate([self.keys[keep], fresh])
        order = np.argsort(keys, kind='stable')
        self.keys = keys[order]
        self.values = np.concatenate([self.values[keep], fresh_values])[order]

    def columns(self) -> IntArray:
        """Return the (N,) column of each voxel, an index of the flat `free_above`."""
        x, y = self.keys // (SPAN * SPAN), self.keys // SPAN % SPAN
        return np.asarray(x // 2 * (SPAN // 2) + y // 2)

    def column_centers_m(self, columns: IntArray) -> FloatArray:
        """Return x and y (N, 2) of the centers of columns (N,), in the submap's frame."""
        xy = np.stack(np.divmod(columns, SPAN // 2), axis=1) * 2 + 1 - _OVERLAP
        return np.asarray(xy * self._config.voxel_m)

    def clear(self) -> None:
        self.keys, self.values, free_above = self._base
        self.free_above = free_above.copy()
        self.poses.clear()
        self.fused.clear()
        self.marked.clear()
        self.num_fused = 0
        self.is_bent = False
        self.revision += 1

    def keep_as_saved(self) -> None:
        """Make the present voxels, which must be on disk, the base of later rebuilds.

        Their images are not stored, so the voxels must survive when other images are fused again.
        """
        self._base = self.keys, self.values, self.free_above.copy()

    def forget(self, slot: int) -> None:
        """Forget the pose of an image that is no longer stored; the voxels are unchanged."""
        self.poses.pop(slot, None)
        self.fused.discard(slot)
        self.marked.discard(slot)

    def bend_m(self, poses: dict[int, FloatArray]) -> float:
        """Return the largest displacement [m] of a cube corner relative to the fused images.

        `poses` has the present T_map_camera (4, 4) of all stored images, by slot.
        """
        slots = list(self.fused)
        if not slots:
            return 0.0
        before = np.array([self.poses[slot] for slot in slots])
        now = se3.inverse(self.T_map_submap) @ np.array([poses[slot] for slot in slots])
        change = now @ np.linalg.inv(before)
        corners = _CORNERS * SIDE * self._config.voxel_m
        moved = corners @ change[:, :3, :3].transpose(0, 2, 1) + change[:, None, :3, 3] - corners
        return float(np.linalg.norm(moved, axis=2).max())

    def _sums_of(self, surface: Surface) -> tuple[NDArray[np.int32], Float32Array]:
        cell = np.floor(surface.points_m / self._config.voxel_m).astype(np.int32) + _OVERLAP
        keys = (cell[:, 0] * SPAN + cell[:, 1]) * SPAN + cell[:, 2]
        weights = surface.weights[:, None]
        ones = np.ones((len(keys), 2))
        means = np.concatenate([surface.points_m, surface.colors_bgr], axis=1)
        columns = np.concatenate([weights * means, weights, ones], axis=1)
        keys, inverse = np.unique(keys, return_inverse=True)
        out = np.zeros((len(keys), _NUM_COLUMNS), np.float32)
        # No two voxels of the map frame fall into the same voxel here.
        if len(keys) == len(inverse):
            out[inverse] = columns
        else:
            np.add.at(out, inverse, columns.astype(np.float32))
            out[:, _HITS:] = 1
        return keys, out

    def _load(self) -> None:
        if not self.is_in_memory:
            self.keys, self.values = np.array(self.keys), np.array(self.values)


# Four of the eight corners of a cube with side 1, which span a tetrahedron.
_CORNERS = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], np.float64)


def transform(T: FloatArray, points: Float32Array) -> Float32Array:
    """Return points (N, 3), transformed in single precision."""
    return np.asarray(points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32))


def move_to_disk(submaps: Sequence[Submap]) -> None:
    """Move the voxels of submaps (at least one voxel in total) to an unnamed temporary file.

    The arrays become read-only memory maps, so that all reading works as before and the operating
    system decides which part of the file stays in memory. The file is deleted when no submap uses
    it any more. OSError if the file cannot be written.
    """
    for name in ('keys', 'values'):
        arrays = [getattr(submap, name) for submap in submaps]
        with TemporaryFile() as file:
            for array in arrays:
                array.tofile(file)
            file.flush()
            rows = sum(map(len, arrays))
            whole = np.memmap(file, arrays[0].dtype, 'r', shape=(rows, *arrays[0].shape[1:]))
        start = 0
        for submap, array in zip(submaps, arrays, strict=True):
            setattr(submap, name, whole[start : start + len(array)])
            start += len(array)


def cells_of_keys(keys: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the cells (N, 3), in the order x, y, z, of the keys of voxels.

    Cell (0, 0, 0) lies at the origin of the submap's frame, the corner of its cube without the
    overlap. Cells in the overlap are negative or at least `SIDE`.
    """
    x, rest = np.divmod(keys, SPAN * SPAN)
    return np.asarray(np.stack([x, *np.divmod(rest, SPAN)], axis=1) - _OVERLAP)


def _find(keys: NDArray[np.int32], wanted: NDArray[np.int32]) -> tuple[IntArray, BoolArray]:
    """Return the (M,) positions of wanted keys in sorted keys, and the mask of the found keys."""
    at = np.searchsorted(keys, wanted)
    known = np.zeros(len(at), np.bool_)
    inside = at < len(keys)
    known[inside] = keys[at[inside]] == wanted[inside]
    return at, known


def num_in_memory(submaps: Iterable[Submap]) -> int:
    return sum(len(submap) for submap in submaps if submap.is_in_memory)
