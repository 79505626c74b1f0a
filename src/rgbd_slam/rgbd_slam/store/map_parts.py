"""Copies of the changed rows of a map, in parts, so that tracking never waits long.

The features of a keyframe never change, and are copied once. The observed point of each feature,
and the map points, are copied again after each change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.io.records import Array
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import NONE, MapState, joined_rows
from rgbd_slam.records.soa_table import DEAD
from rgbd_slam.store.tables import CHUNK, FeatureRows, PointRows, StateRows

# Chosen: largest numbers of keyframes (5 MB of features) and of chunks of points (50,000 points)
# in a part, so that a part is copied in a few ms.
_MAX_KEYFRAMES, _MAX_CHUNKS = 96, 200
_NEVER = -1  # in place of a version: the row was not copied yet
_UNKNOWN = -2  # in place of a uid: no features are stored; -1 is the uid of an empty row
_FEATURE_COLUMNS = ('depth_m', 'octave', 'angle_deg', 'descriptors')


class KeyframeCopy(NamedTuple):
    """All K keyframes without their features, by ascending uid."""

    uid: IntArray  # (K,)
    stamp_ns: IntArray  # (K,)
    map_id: IntArray  # (K,)
    parent_uid: IntArray  # (K,) DEAD for the root of a map
    T_core_camera: FloatArray  # (K, 4, 4)


class MapPart(NamedTuple):
    """Copies of new and changed rows: of N new and M changed keyframes, and of points."""

    new_uids: IntArray  # (N,) keyframes whose features are in `features`
    new_counts: IntArray  # (N,) number of features of each
    features: FeatureRows
    changed_uids: IntArray  # (M,) keyframes whose feature states are in `states`
    changed_counts: IntArray  # (M,) number of features of each
    states: StateRows
    chunks: IntArray  # (C,) ascending numbers of the chunks of points that are in `points`
    points: PointRows
    keyframes: KeyframeCopy | None  # None: this is not the last part
    loops: tuple[LoopEdge, ...]  # all loop edges


def part_of(
    state: MapState, uids: IntArray | None = None, loops: tuple[LoopEdge, ...] = ()
) -> MapPart:
    """Return a whole saved map as one part; `uids` (K,) belong to its keyframes."""
    uids = np.arange(len(state)) if uids is None else uids
    counts, rows = state.num_features.astype(np.int64), np.arange(len(state.position_m))
    map_id = state.map_id.astype(np.int64)
    parent_uid = np.where(state.parent == NONE, DEAD, uids[state.parent])
    return MapPart(
        uids,
        counts,
        FeatureRows(state.uv_px, *(getattr(state, name) for name in _FEATURE_COLUMNS)),
        uids,
        counts,
        StateRows(state.point, state.may_seed),
        np.unique(rows // CHUNK),
        PointRows(
            rows.astype(np.int32),
            state.position_m,
            uids[state.reference],
            state.num_visible,
            state.num_found,
        ),
        KeyframeCopy(uids, state.stamp_ns, map_id, parent_uid, state.T_map_camera),
        loops,
    )


class MapParts:
    """Records which rows of a map were copied, and copies the others.

    `copy` is called repeatedly, between images, until a part has keyframes: all copied rows
    together then are the map at its version in this last call.
    """

    def __init__(self, atlas: Atlas) -> None:
        self.atlas = atlas
        nothing: IntArray = np.empty(0, np.int64)
        self._uid = nothing  # by row: uid of the keyframe whose features were copied
        # Version of the map at which the feature states of a keyframe (by row) were copied last,
        # and a chunk of points (by chunk).
        self._state_version, self._chunk_version = nothing, nothing

    def state(self) -> tuple[IntArray, ...]:
        """Return which rows were copied, for `restore`."""
        return self._uid.copy(), self._state_version.copy(), self._chunk_version.copy()

    def restore(self, state: tuple[IntArray, ...]) -> None:
        """Forget which rows `copy` has copied since `state`, so that they are copied again."""
        self._uid, self._state_version, self._chunk_version = (rows.copy() for rows in state)

    def copy(self) -> MapPart:
        """Return a copy of the next changed rows, which takes a few ms."""
        atlas, kf, points = self.atlas, self.atlas.keyframes, self.atlas.points
        last_change = np.maximum.reduceat(
            np.maximum(points.version, points.shifted), np.arange(0, points.capacity, CHUNK)
        )
        self._grow(len(last_change))
        rows = kf.indices_by_uid()
        is_new = self._uid[rows] != kf.uid[rows]
        left = rows[is_new | (kf.reobserved[rows] > self._state_version[rows])]
        chunks = np.flatnonzero(last_change > self._chunk_version)
        is_last = len(left) <= _MAX_KEYFRAMES and len(chunks) <= _MAX_CHUNKS
        changed, chunks = left[:_MAX_KEYFRAMES], chunks[:_MAX_CHUNKS]
        new = changed[self._uid[changed] != kf.uid[changed]]
        self._uid[new] = kf.uid[new]
        self._state_version[changed] = self._chunk_version[chunks] = atlas.version
        return MapPart(
            kf.uid[new],
            kf.num_features[new],
            self._features(new),
            kf.uid[changed],
            kf.num_features[changed],
            self._states(changed),
            chunks,
            self._points(chunks),
            self._keyframes(rows) if is_last else None,
            atlas.loops,
        )

    def _grow(self, num_chunks: int) -> None:
        capacity = self.atlas.keyframes.capacity
        self._uid = _grown(self._uid, capacity, _UNKNOWN)
        self._state_version = _grown(self._state_version, capacity, _NEVER)
        self._chunk_version = _grown(self._chunk_version, num_chunks, _NEVER)

    def _features(self, rows: IntArray) -> FeatureRows:
        kf, runs = self.atlas.keyframes, self._runs(rows)
        columns: dict[str, Array] = {
            name: joined_rows(getattr(kf, name), runs) for name in _FEATURE_COLUMNS
        }
        return FeatureRows(uv_px=joined_rows(kf.measurement_px[..., :2], runs), **columns)

    def _states(self, rows: IntArray) -> StateRows:
        kf, runs = self.atlas.keyframes, self._runs(rows)
        return StateRows(joined_rows(kf.point_of_feature, runs), joined_rows(kf.may_seed, runs))

    def _points(self, chunks: IntArray) -> PointRows:
        points = self.atlas.points
        is_copied = np.zeros(len(self._chunk_version), np.bool_)
        is_copied[chunks] = True
        is_copied = np.repeat(is_copied, CHUNK)[: points.capacity]
        rows = np.flatnonzero(is_copied & (points.uid != DEAD))
        return PointRows(
            rows.astype(np.int32),
            points.position_m[rows],
            points.reference_keyframe_uid[rows],
            points.num_visible[rows],
            points.num_found[rows],
        )

    def _keyframes(self, rows: IntArray) -> KeyframeCopy:
        kf = self.atlas.keyframes
        return KeyframeCopy(
            kf.uid[rows],
            kf.stamp_ns[rows],
            kf.map_id[rows],
            kf.parent_uid[rows],
            kf.T_map_camera[rows],
        )

    def _runs(self, rows: IntArray) -> Sequence[tuple[int, int]]:
        counts = self.atlas.keyframes.num_features[rows]
        return list(zip(rows.tolist(), counts.tolist(), strict=True))


def _grown(array: IntArray, size: int, value: int) -> IntArray:
    return np.pad(array, (0, max(size - len(array), 0)), constant_values=value)
