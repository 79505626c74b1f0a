"""Exports of the dense map, with the voxels of the submaps that changed since an earlier one."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.submap import Submap
from hoid_scene.dense.submap_state import SubmapState


class ExportMark(NamedTuple):
    """Identifies an export of a dense map."""

    token: str  # random name of the dense map; a new dense map has another one
    serial: int


class SubmapExport(NamedTuple):
    """The S submaps with voxels whose anchors are saved, and the contents of some of them."""

    mark: ExportMark
    numbers: IntArray  # (S,) that identify the submaps
    anchor_uids: IntArray  # (S,)
    T_anchor_submap: FloatArray  # (S, 4, 4)
    changed_numbers: IntArray  # (C,) of the submaps that are in `changed`, in this order
    changed: SubmapState

    def write(self, path: Path) -> None:
        """Write the export to a file (`.npz`) for another process.

        Raises:
            OSError: The file cannot be written.
        """
        own = {_PREFIX + name: getattr(self, name) for name in _ARRAYS}
        mark = {'token': np.array(self.mark.token), 'serial': np.array(self.mark.serial)}
        np.savez(path, allow_pickle=False, **mark, **own, **self.changed.arrays())

    @classmethod
    def read(cls, path: Path) -> SubmapExport:
        """Return the export in a file that `write` made.

        Raises:
            OSError: The file cannot be read.
        """
        with np.load(path) as arrays:
            mark = ExportMark(str(arrays['token']), int(arrays['serial']))
            own = {name: arrays[_PREFIX + name] for name in _ARRAYS}
            return cls(mark, changed=SubmapState.of(arrays), **own)


_PREFIX = 'all_'  # distinguishes these arrays from those of the changed submaps
_ARRAYS = ('numbers', 'anchor_uids', 'T_anchor_submap', 'changed_numbers')


class _Exported(NamedTuple):
    number: int
    content_revision: int
    serial: int  # of the export in which this content was new


class SubmapExports:
    """Numbers the submaps of a dense map, and records in which export their contents were new.

    Args:
        config: Gives the size of a voxel.
    """

    def __init__(self, config: DenseConfig) -> None:
        self._config = config
        self._token, self._serial = secrets.token_hex(8), 0
        self._numbers = count()
        self._exported: dict[Submap, _Exported] = {}

    def since(
        self, mark: ExportMark | None, submaps: Sequence[Submap], keyframe_uids: IntArray
    ) -> SubmapExport:
        """Return the submaps whose anchors are saved, with the contents that are new.

        Submaps without voxels are left out. The export gets the next serial number.

        Args:
            mark: Contents are new if they have changed since this export. All are new if it is
                None, or an export of another dense map.
            submaps: All submaps.
            keyframe_uids: (K,) ascending uids of the saved keyframes.
        """
        self._serial += 1
        self._exported = {submap: self._update(submap) for submap in submaps}
        saved = set(keyframe_uids.tolist())
        kept = [submap for submap in submaps if len(submap) and submap.anchor_uid in saved]
        start = mark.serial if mark is not None and mark.token == self._token else 0
        changed = [submap for submap in kept if self._exported[submap].serial > start]
        return SubmapExport(
            ExportMark(self._token, self._serial),
            self._numbers_of(kept),
            np.array([submap.anchor_uid for submap in kept], np.int64),
            np.array([submap.T_anchor_submap for submap in kept]).reshape(-1, 4, 4),
            self._numbers_of(changed),
            SubmapState.of_submaps(changed, keyframe_uids, self._config),
        )

    def _update(self, submap: Submap) -> _Exported:
        known = self._exported.get(submap)
        if known is None:
            return _Exported(next(self._numbers), submap.content_revision, self._serial)
        if known.content_revision == submap.content_revision:
            return known
        return _Exported(known.number, submap.content_revision, self._serial)

    def _numbers_of(self, submaps: Sequence[Submap]) -> IntArray:
        return np.array([self._exported[submap].number for submap in submaps], np.int64)
