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

from hoid_common.io.records import Array, Record, column
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import joined_rows

# Chosen: a part of so many keyframes (5 MB of features) and points is copied in a few ms.
_MAX_KEYFRAMES = 96
_MAX_POINTS = 50_000
_NEVER = -1  # instead of a version: the row has not been copied
_UNKNOWN = -2  # instead of a uid: no features are stored; -1 is the uid of an empty row
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
    """The columns of features that change."""

    point: Annotated[NDArray[np.int32], column('i4', 'features')]  # row in the atlas, or NO_POINT
    may_seed: Annotated[BoolArray, column('?', 'features')]


@dataclass(frozen=True, eq=False)
class PointRows(Record):
    """Map points."""

    row: Annotated[NDArray[np.int32], column('i4', 'points')]  # in the atlas's table of points
    position_m: Annotated[FloatArray, column('f8', 'points', 3)]  # in the core's map frame
    reference_uid: Annotated[IntArray, column('i8', 'points')]  # of the reference keyframe
    num_visible: Annotated[IntArray, column('i8', 'points')]  # frames that should show it
    num_found: Annotated[IntArray, column('i8', 'points')]  # frames in which it was found


class KeyframeCopy(NamedTuple):
    """All K keyframes without their features, by ascending uid."""

    rows: IntArray  # (K,) in the atlas's table of keyframes
    columns: dict[str, Array]  # (K, ...) by the names of the columns
    num_points: int  # number of points of the map


class MapPart(NamedTuple):
    """Copies of new and changed rows: those of M keyframes, and some map points."""

    version: int  # of the map when the rows were copied
    changed: IntArray  # (M,) rows of the keyframes in the atlas
    uids: IntArray  # (M,) uids of these keyframes
    num_features: IntArray  # (M,) numbers of their features, whose states are in `states`
    is_new: BoolArray  # (M,) whether their features are in this part as well, in `features`
    states: StateRows
    features: FeatureRows
    points: PointRows
    keyframes: KeyframeCopy | None  # None: more parts follow


class MapParts:
    """Records which rows of a map are stored, and copies those that are not.

    `copy` is called between two images. After its part has been stored, `note` must be called.
    Both are repeated until a part has keyframes: all stored rows together are then the map at the
    version of this part.

    Args:
        atlas: The map.
    """

    def __init__(self, atlas: Atlas) -> None:
        self.atlas = atlas
        # By row of the table of keyframes: uid of the keyframe whose features are stored.
        self._uid: IntArray = np.empty(0, np.int64)
        # The version of the map at which the states of a keyframe's features were copied, by row
        # of the table of keyframes, and that at which a point was copied, by row of the table of
        # points.
        self._state_version: IntArray = np.empty(0, np.int64)
        self._point_version: IntArray = np.empty(0, np.int64)
        # By row of the table of keyframes: the row of the keyframe's first feature among all
        # stored features (the segment `features` of a checkpoint), and of its first state among
        # all stored states (the segment `states`).
        self._first_feature: IntArray = np.empty(0, np.int64)
        self._first_state: IntArray = np.empty(0, np.int64)

    def copy(self) -> MapPart:
        """Return a copy of the next rows that are not stored; it takes a few ms."""
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
        """Record that a part is stored.

        Args:
            part: The part.
            first_feature: Row of its first feature among all stored features.
            first_state: Row of its first state among all stored states.
        """
        new, counts = part.changed[part.is_new], part.num_features
        self._uid[new] = part.uids[part.is_new]
        self._state_version[part.changed] = part.version
        self._point_version[part.points.row] = part.version
        self._first_feature[new] = first_feature + _starts(counts[part.is_new])
        self._first_state[part.changed] = first_state + _starts(counts)

    def located(self, keyframes: KeyframeCopy) -> dict[str, Array]:
        """Return the columns of keyframes (K,), with those that say where their features are.

        `first_feature` and `first_state` are the rows of each keyframe's first feature and first
        state among all stored ones. All parts before the keyframes must have been noted.
        """
        return keyframes.columns | {
            'first_feature': self._first_feature[keyframes.rows],
            'first_state': self._first_state[keyframes.rows],
        }

    def forget_features(self) -> None:
        """Let the next parts contain the features of all keyframes again."""
        self._uid[:] = _UNKNOWN

    def forget_states(self) -> None:
        """Let the next parts contain the states of all features again."""
        self._state_version[:] = _NEVER

    def forget_points(self) -> None:
        """Let the next parts contain all points again."""
        self._point_version[:] = _NEVER

    def _grow(self) -> None:
        """Enlarge the arrays to the present capacities of the map's tables."""
        keyframes, points = self.atlas.keyframes.capacity, self.atlas.points.capacity
        self._uid = _grown(self._uid, keyframes, _UNKNOWN)
        self._state_version = _grown(self._state_version, keyframes, _NEVER)
        self._first_feature = _grown(self._first_feature, keyframes, 0)
        self._first_state = _grown(self._first_state, keyframes, 0)
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
