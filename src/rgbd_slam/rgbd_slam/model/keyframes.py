"""The keyframes as a structure of arrays: poses, features, and the points that they observe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.records.disk_array import DiskArray
from rgbd_slam.records.soa_table import DEAD, Column, SoaTable, SoaTableRows

NO_POINT = -1

_INITIAL_CAPACITY = 32
_INITIAL_FEATURES = 1024
# Chosen: if the table has more rows, the columns of features are in a file instead of in memory,
# except for the observed points. Those of 1,000 keyframes take 60 MB.
_MEMORY_ROWS = 1024
# Chosen: number of keyframes that are stored at once, so that their columns fit the cache.
_ROWS_AT_ONCE = 64
# Chosen: number of new keyframes after which the operating system may reclaim the memory of the
# columns below; they are read from the file again when they are used.
_RELEASE_AFTER = 100
_FIXED_FEATURES = ('measurement_px', 'depth_m', 'octave', 'angle_deg', 'descriptors', 'may_seed')
_OBSERVATIONS = ('connected', 'reobserved', 'is_reobserved')


class KeyframeTable(SoaTable):
    """The table of keyframes (index letter i); feature columns are (capacity, max features, ...).

    Only `Atlas` writes to the columns. `point_of_feature` holds the observations; the graph of the
    `Atlas` is its inverse.
    """

    fixed: ClassVar[tuple[str, ...]] = ('stamp_ns', 'num_features', 'is_loaded', *_FIXED_FEATURES)
    local: ClassVar[tuple[str, ...]] = (*SoaTable.local, *_OBSERVATIONS, 'point_of_feature')
    wide: ClassVar[tuple[str, ...]] = ('stamp_ns',)

    def __init__(self) -> None:
        n, f = _INITIAL_CAPACITY, _INITIAL_FEATURES
        super().__init__(n)
        self.stamp_ns: IntArray = np.zeros(n, np.int64)
        self.T_map_camera: FloatArray = np.zeros((n, 4, 4))
        self.map_id: IntArray = np.zeros(n, np.int64)  # each map has its own frame
        # Parent in the spanning tree; DEAD for the root of a map.
        self.parent_uid: IntArray = np.zeros(n, np.int64)
        self.num_features: IntArray = np.zeros(n, np.int64)
        self.is_loaded: BoolArray = np.zeros(n, np.bool_)  # True: from an earlier session
        # Version of the map at which the points shared with others were counted last.
        self.connected: IntArray = np.zeros(n, np.int64)
        # Version of the map at which an observation or `may_seed` of the keyframe changed last,
        # and the mask of features with changes that are not sent to another copy yet.
        self.reobserved: IntArray = np.zeros(n, np.int64)
        self.is_reobserved: NDArray[np.bool_] = np.zeros((n, f), np.bool_)
        self.point_of_feature: NDArray[np.int32] = np.full((n, f), NO_POINT, np.int32)
        # u, v, u_right; u_right is NaN without depth.
        self.measurement_px: Float32Array = np.zeros((n, f, 3), np.float32)
        self.depth_m: Float32Array = np.zeros((n, f), np.float32)
        self.octave: ByteArray = np.zeros((n, f), np.uint8)
        self.angle_deg: Float32Array = np.zeros((n, f), np.float32)
        self.descriptors: ByteArray = np.zeros((n, f, 32), np.uint8)
        self.may_seed: NDArray[np.bool_] = np.zeros((n, f), np.bool_)
        self._on_disk: dict[str, DiskArray] = {}  # columns of a large map
        self._num_put = 0  # number of keyframes whose features were stored

    @property
    def max_features(self) -> int:
        return int(self.point_of_feature.shape[1])

    def grow(self, capacity: int) -> None:
        old = self.capacity
        super().grow(capacity)
        self.point_of_feature[old:] = NO_POINT

    def _grown(self, name: str, capacity: int) -> Column:
        if capacity <= _MEMORY_ROWS or name not in _FIXED_FEATURES:
            return super()._grown(name, capacity)
        column = self._on_disk.setdefault(
            name, DiskArray(getattr(self, name), 'features of the map')
        )
        column.grow(capacity)
        return column.array

    def release_memory(self) -> None:
        """Let the operating system reclaim the memory of columns in files until they are read."""
        for column in self._on_disk.values():
            column.release_memory()

    def grow_features(self, max_features: int) -> None:
        self._on_disk.clear()
        for name in ('is_reobserved', 'point_of_feature', *_FIXED_FEATURES):
            old = getattr(self, name)
            new = np.zeros((old.shape[0], max_features, *old.shape[2:]), old.dtype)
            new[:, : old.shape[1]] = old
            if name == 'point_of_feature':
                new[:, old.shape[1] :] = NO_POINT
            setattr(self, name, new)
        if self.capacity > _MEMORY_ROWS:
            for name in _FIXED_FEATURES:
                setattr(self, name, self._grown(name, self.capacity))

    def store_features(self, i: int, frame: Frame) -> None:
        """Copy the features of a frame into row `i`, without observations."""
        self.stamp_ns[i] = frame.stamp_ns
        self.num_features[i] = len(frame)
        self.point_of_feature[i] = NO_POINT
        self.put_features(i, frame)

    def put_features(self, i: int, frame: Frame) -> None:
        """Copy the features of a frame into row `i`; observations and counts are not changed."""
        n = len(frame)
        if n > self.max_features:
            self.grow_features(max(n, self.max_features + self.max_features // 2))
        for name in _FIXED_FEATURES:
            getattr(self, name)[i, :n] = getattr(frame, name)
        self._num_put += 1
        if self._num_put % _RELEASE_AFTER == 0:
            self.release_memory()

    def reserve_features(self, max_features: int) -> None:
        if max_features > self.max_features:
            self.grow_features(max_features)

    def append_features(self, rows: IntArray, columns: Mapping[str, Column]) -> None:
        """Store the columns (F, ...) of the features of keyframes (N,), sorted by keyframe."""
        counts = self.num_features[rows]
        ends = np.cumsum(counts)
        is_run = bool((np.diff(rows) == 1).all())
        step = _ROWS_AT_ONCE if is_run else 1
        for name, values in columns.items():
            table = getattr(self, name)
            for start in range(0, len(rows), step):
                part = slice(start, start + step)
                block = np.zeros((len(rows[part]), *table.shape[1:]), table.dtype)
                # This is ten times as fast as one assignment by index arrays.
                for row, n, end in zip(
                    block, counts[part].tolist(), ends[part].tolist(), strict=True
                ):
                    row[:n] = values[end - n : end]
                self._put_rows(name, int(rows[start]), block)
        self.release_memory()

    def _put_rows(self, name: str, first: int, rows: Column) -> None:
        column = self._on_disk.get(name)
        if column is None:
            getattr(self, name)[first : first + len(rows)] = rows
        else:
            column.write_rows(first, rows)

    def frame(self, i: int) -> Frame:
        """Return the features of row `i` as a frame whose arrays are views, not copies."""
        n = int(self.num_features[i])
        return Frame(
            int(self.stamp_ns[i]),
            self.measurement_px[i, :n],
            self.depth_m[i, :n],
            self.octave[i, :n],
            self.angle_deg[i, :n],
            self.descriptors[i, :n],
            self.may_seed[i, :n],
        )

    def points_of(self, i: int) -> IntArray:
        """Return the point (N,) that each feature of row `i` observes, or NO_POINT, as a copy."""
        return self.point_of_feature[i, : self.num_features[i]].astype(np.int64)

    def children(self, i: int) -> IntArray:
        return np.flatnonzero((self.parent_uid == self.uid[i]) & (self.uid != DEAD))

    def ends_of(self, edge: LoopEdge) -> tuple[int, int] | None:
        """Return the rows of both keyframes of a loop; None unless both exist in one map."""
        a, b = self.index_of(edge.first_uid), self.index_of(edge.second_uid)
        if a is None or b is None or self.map_id[a] != self.map_id[b]:
            return None
        return a, b

    def rows_since(self, version: int, *, with_features: bool = True) -> SoaTableRows:
        change = super().rows_since(version)
        if with_features:
            return change
        fixed = change.fixed_columns
        kept = {name: fixed[name] for name in fixed if name not in _FIXED_FEATURES}
        return change._replace(fixed_columns=kept)

    def put_rows(self, change: SoaTableRows, version: int) -> None:
        if 'octave' in change.fixed_columns:
            width = change.fixed_columns['octave'].shape[1]
            if width > self.max_features:
                self.grow_features(width)
        super().put_rows(change, version)
        if len(change.new_rows) > _RELEASE_AFTER:
            self.release_memory()
