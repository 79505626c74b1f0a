"""The dense map in a map file: its submaps, each relative to its anchor keyframe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.records import Record, column
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.submap import SPAN, Submap, cells_of_keys
from hoid_scene.place import Place

_STEPS = 256  # quantization of an offset within a voxel: number of steps along an axis
_OF_VOXELS = ('key', 'offset', 'color_bgr', 'weight', 'counts')


@dataclass(frozen=True, eq=False)
class SubmapState(Record):
    """S submaps in a file, with N voxels in all, sorted by submap and key; 16 bytes per voxel."""

    voxel_m: Annotated[FloatArray, column('f8', 1)]  # side of a voxel
    anchor: Annotated[NDArray[np.int32], column('i4', 'submaps')]  # row of the saved keyframe
    T_anchor_submap: Annotated[FloatArray, column('f8', 'submaps', 4, 4)]
    num_voxels: Annotated[NDArray[np.int32], column('i4', 'submaps')]
    free_above: Annotated[NDArray[np.uint16], column('u2', 'submaps', SPAN // 2, SPAN // 2)]
    key: Annotated[NDArray[np.int32], column('i4', 'voxels')]
    # The mean point's offset in its voxel, in steps of 1 / 256 voxel.
    offset: Annotated[NDArray[np.uint8], column('u1', 'voxels', 3)]
    color_bgr: Annotated[ByteArray, column('u1', 'voxels', 3)]
    weight: Annotated[Float32Array, column('f4', 'voxels')]
    # Two numbers for each voxel, each at most 30: the images that confirmed it (measured the
    # surface within half a voxel of it), less 3 for each image that saw through it; and the images
    # that measured static surface near it.
    counts: Annotated[NDArray[np.uint8], column('u1', 'voxels', 2)]

    def __len__(self) -> int:
        return len(self.key)

    @classmethod
    def of_submaps(
        cls, submaps: Sequence[Submap], keyframe_uids: IntArray, config: DenseConfig
    ) -> SubmapState:
        """Return the record of the submaps that have voxels and anchors among the uids (K,)."""
        saved = set(keyframe_uids.tolist())
        kept = [submap for submap in submaps if len(submap) and submap.place.uid in saved]
        key = np.concatenate([np.empty(0, np.int32), *(submap.keys for submap in kept)])
        values = np.concatenate([np.empty((0, 9), np.float32), *(s.values for s in kept)])
        weight = values[:, 6]
        mean = values[:, :6] / weight[:, None]
        offset = (mean[:, :3] / config.voxel_m - cells_of_keys(key)) * _STEPS
        uids = np.array([submap.place.uid for submap in kept], np.int64)
        return cls.of(
            {
                'voxel_m': np.array([config.voxel_m]),
                'anchor': np.searchsorted(keyframe_uids, uids),
                'T_anchor_submap': _stacked([s.place.T_anchor_place for s in kept], (4, 4)),
                'num_voxels': np.array([len(submap) for submap in kept], np.int32),
                'free_above': _stacked([s.free_above for s in kept], (SPAN // 2, SPAN // 2)),
                'key': key,
                'offset': np.clip(offset, 0, _STEPS - 1),
                'color_bgr': mean[:, 3:].round(),
                'weight': weight,
                'counts': values[:, 7:],
            }
        )

    @classmethod
    def joined(cls, parts: Sequence[SubmapState]) -> SubmapState:
        """Return one record of the submaps of several records, whose voxels have the same size."""
        columns = [state.arrays() for state in parts]
        together = {name: np.concatenate([c[name] for c in columns]) for name in columns[0]}
        return cls.of({**together, 'voxel_m': parts[0].voxel_m})

    def with_anchors(self, anchor: IntArray) -> SubmapState:
        """Return the submaps with new anchors (S,); submaps with the anchor -1 are left out."""
        return self.of({**self._rows(anchor >= 0).arrays(), 'anchor': anchor[anchor >= 0]})

    def split(self) -> list[SubmapState]:
        return [self._rows(np.arange(len(self.anchor)) == s) for s in range(len(self.anchor))]

    def _rows(self, kept: BoolArray) -> SubmapState:
        of_voxel = np.repeat(kept, self.num_voxels)
        return self.of(
            {
                name: array[of_voxel] if name in _OF_VOXELS else array[kept]
                for name, array in self.arrays().items()
                if name != 'voxel_m'
            }
            | {'voxel_m': self.voxel_m}
        )

    def submaps(
        self, keyframes: KeyframePoses, keyframe_uids: IntArray, config: DenseConfig
    ) -> list[Submap]:
        """Return the saved submaps, placed by the present poses of their anchor keyframes."""
        center = (self.offset + np.float32(0.5)) / _STEPS
        mean_m = (cells_of_keys(self.key) + center) * self.voxel_m[0]
        weight = self.weight[:, None]
        columns = [weight * mean_m, weight * self.color_bgr, weight, self.counts]
        values = np.concatenate(columns, axis=1).astype(np.float32)
        ends = np.cumsum(self.num_voxels)[:-1]
        out = []
        for row, key, part in zip(
            range(len(self.anchor)), np.split(self.key, ends), np.split(values, ends), strict=True
        ):
            uid = int(keyframe_uids[self.anchor[row]])
            place = Place.saved(self.T_anchor_submap[row], uid, keyframes)
            if place is not None:
                submap = Submap(place, config)
                submap.keys, submap.values = key.copy(), part.copy()
                submap.free_above = self.free_above[row].copy()
                out.append(submap)
        return out


def _stacked(arrays: Sequence[NDArray[np.generic]], shape: tuple[int, ...]) -> NDArray[np.generic]:
    return np.array(arrays).reshape(len(arrays), *shape)
