"""Copies of the rows of a map that changed, part by part, so that tracking never waits long.

The features of a keyframe never change, and are copied once. The points that its features observe,
and the map points, are copied again whenever they have changed. The keyframes themselves (poses,
spanning tree) are few bytes, and are copied with the last part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import joined_rows
from rgbd_slam.records.record import Array, Record, column

# Chosen: a part of so many keyframes (5 MB of features) and points is copied in a few ms.
_MAX_KEYFRAMES = 96
_MAX_POINTS = 50_000
_NEVER = -1  # no version of a map
_UNKNOWN = -2  # no uid, not even that of an empty row
_FEATURE_COLUMNS = ('depth_m', 'octave', 'angle_deg', 'descriptors')
_KEYFRAME_COLUMNS = ('uid', 'stamp_ns', 'T_map_camera', 'map_id', 'parent_uid', 'num_features')


@dataclass(frozen=True, eq=False)
class FeatureRows(Record):
    """Features of keyframes, which never change."""

    uv_px: Annotated[Float32Array, column('f4', 'features', 2)]
    depth_m: Annotated[Float32Array, column('f4', 'features')]
    octave: Annotated[ByteArray, column('u1', 'features')]
    angle_deg: Annotated[Float32Array, column('f4', 'features')]
    descriptors: Annotated[ByteArray, column('u1', 'features', 32)]


@dataclass(frozen=True, eq=False)
class StateRows(Record):
    """The part of features that changes."""

    point: Annotated[NDArray[np.int32], column('i4', 'features')]  # row in the atlas, or NO_POINT
    may_seed: Annotated[BoolArray, column('?', 'features')]


@dataclass(frozen=True, eq=False)
class PointRows(Record):
    """Map points."""

    row: Annotated[NDArray[np.int32], column('i4', 'points')]  # in the atlas
    position_m: Annotated[FloatArray, column('f8', 'points', 3)]  # in the core's map frame
    reference_uid: Annotated[IntArray, column('i8', 'points')]  # of the reference keyframe
    num_visible: Annotated[IntArray, column('i8', 'points')]
    num_found: Annotated[IntArray, column('i8', 'points')]


class KeyframeCopy(NamedTuple):
    """All K keyframes without their features, by ascending uid."""

    rows: IntArray  # (K,) in the atlas
    columns: dict[str, Array]  # (K, ...)
    num_points: int  # of the map


class MapPart(NamedTuple):
    """Copies of some changed rows."""

    version: int  # of the map when they were copied
    changed: IntArray  # (M,) rows of the keyframes whose states these are
    uids: IntArray  # (M,) of these
    num_features: IntArray  # (M,) of these
    is_new: BoolArray  # (M,) whether their features are in this part, too
    states: StateRows
    features: FeatureRows
    points: PointRows
    keyframes: KeyframeCopy | None  # None: more parts follow


class MapParts:
    """Records which rows of a map are stored, and copies those that are not.

    `copy` is called between two images. After its part has been stored, `note` must be called.
    Repeat both until a part has keyframes: then everything stored is the map at this version.

    Args:
        atlas: The map.
    """

    def __init__(self, atlas: Atlas) -> None:
        self.atlas = atlas
        self._uid: IntArray = np.empty(0, np.int64)  # by row: whose features are stored
        # By row: the version at which the states of the keyframe, or the point, was copied.
        self._state_version: IntArray = np.empty(0, np.int64)
        self._point_version: IntArray = np.empty(0, np.int64)
        # By row: the number of the first feature and of the first state in the segments.
        self.first_feature: IntArray = np.empty(0, np.int64)
        self.first_state: IntArray = np.empty(0, np.int64)

    def copy(self) -> MapPart:
        """Copy the next part."""
        self._grow()
        atlas, kf, points = self.atlas, self.atlas.keyframes, self.atlas.points
        rows = kf.indices()
        is_new = self._uid[rows] != kf.uid[rows]
        left = rows[is_new | (kf.reobserved[rows] > self._state_version[rows])]
        last_change = np.maximum(points.version, points.shifted)
        points_left = np.flatnonzero((last_change > self._point_version) & points.alive)
        is_last = len(left) <= _MAX_KEYFRAMES and len(points_left) <= _MAX_POINTS
        changed = left[:_MAX_KEYFRAMES]
        is_new = self._uid[changed] != kf.uid[changed]
        return MapPart(
            atlas.version,
            changed,
            kf.uid[changed],
            kf.num_features[changed],
            is_new,
            self._states(changed),
            self._features(changed[is_new]),
            self._points(points_left[:_MAX_POINTS]),
            self._keyframes(rows) if is_last else None,
        )

    def note(self, part: MapPart, first_feature: int, first_state: int) -> None:
        """Record that a part is stored, from these rows of the segments on."""
        new, counts = part.changed[part.is_new], part.num_features
        self._uid[new] = part.uids[part.is_new]
        self._state_version[part.changed] = part.version
        self._point_version[part.points.row] = part.version
        self.first_feature[new] = first_feature + _starts(counts[part.is_new])
        self.first_state[part.changed] = first_state + _starts(counts)

    def forget_features(self) -> None:
        """Copy the features of all keyframes again."""
        self._uid[:] = _UNKNOWN

    def forget_states(self) -> None:
        """Copy the states of all features again."""
        self._state_version[:] = _NEVER

    def forget_points(self) -> None:
        """Copy all points again."""
        self._point_version[:] = _NEVER

    def _grow(self) -> None:
        """Make room for the rows of the map."""
        keyframes, points = self.atlas.keyframes.capacity, self.atlas.points.capacity
        self._uid = _grown(self._uid, keyframes, _UNKNOWN)
        self._state_version = _grown(self._state_version, keyframes, _NEVER)
        self.first_feature = _grown(self.first_feature, keyframes, 0)
        self.first_state = _grown(self.first_state, keyframes, 0)
        self._point_version = _grown(self._point_version, points, _NEVER)

    def _features(self, rows: IntArray) -> FeatureRows:
        kf, runs = self.atlas.keyframes, self._runs(rows)
        columns = {name: joined_rows(getattr(kf, name), runs) for name in _FEATURE_COLUMNS}
        return FeatureRows(uv_px=joined_rows(kf.measurement_px[..., :2], runs), **columns)

    def _states(self, rows: IntArray) -> StateRows:
        kf, runs = self.atlas.keyframes, self._runs(rows)
        return StateRows(joined_rows(kf.point_of_feature, runs), joined_rows(kf.may_seed, runs))

    def _points(self, rows: IntArray) -> PointRows:
        points = self.atlas.points
        return PointRows(
            rows.astype(np.int32),
            points.position_m[rows],
            points.reference_keyframe_uid[rows],
            points.num_visible[rows],
            points.num_found[rows],
        )

    def _keyframes(self, rows: IntArray) -> KeyframeCopy:
        kf = self.atlas.keyframes
        rows = rows[np.argsort(kf.uid[rows])]
        columns = {name: getattr(kf, name)[rows] for name in _KEYFRAME_COLUMNS}
        return KeyframeCopy(rows, columns, len(self.atlas.points))

    def _runs(self, rows: IntArray) -> Sequence[tuple[int, int]]:
        counts = self.atlas.keyframes.num_features[rows]
        return list(zip(rows.tolist(), counts.tolist(), strict=True))


def _starts(counts: IntArray) -> IntArray:
    return np.asarray(np.cumsum(counts) - counts)


def _grown(array: IntArray, size: int, value: int) -> IntArray:
    return np.pad(array, (0, max(size - len(array), 0)), constant_values=value)
