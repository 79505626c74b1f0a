"""The map's points as a structure of arrays, and how often frames see them."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.soa_table import SoaTable

_INITIAL_CAPACITY = 4096


class PointTable(SoaTable):
    """Rows are map points, index letter j. Columns are written by `Atlas` alone."""

    columns: ClassVar[tuple[str, ...]] = (
        *SoaTable.columns,
        'position_m',
        'view_direction',
        'min_distance_m',
        'max_distance_m',
        'descriptors',
        'num_observations',
        'num_stereo',
        'num_visible',
        'num_found',
        'first_keyframe_uid',
        'reference_keyframe_uid',
        'map_id',
    )

    def __init__(self) -> None:
        n = _INITIAL_CAPACITY
        super().__init__(n)
        self.position_m: FloatArray = np.zeros((n, 3))  # in the map's frame
        self.view_direction: Float32Array = np.zeros(
            (n, 3), np.float32
        )  # unit, mean, from camera to point
        self.min_distance_m: Float32Array = np.zeros(
            n, np.float32
        )  # ORB scale range, see point_statistics
        self.max_distance_m: Float32Array = np.zeros(n, np.float32)
        self.descriptors: ByteArray = np.zeros((n, 32), np.uint8)
        self.num_observations: IntArray = np.zeros(n, np.int64)  # keyframes that see the point
        self.num_stereo: IntArray = np.zeros(n, np.int64)  # of them, those that read its depth
        self.num_visible: IntArray = np.zeros(n, np.int64)  # frames whose view it should be in
        self.num_found: IntArray = np.zeros(n, np.int64)  # frames that tracked it
        self.first_keyframe_uid: IntArray = np.zeros(n, np.int64)  # the keyframe that made it
        self.reference_keyframe_uid: IntArray = np.zeros(
            n, np.int64
        )  # whose octave set the scale range
        self.map_id: IntArray = np.zeros(n, np.int64)


class PointTally(NamedTuple):
    """Map points that a frame should see, and those it does; no point occurs twice in either."""

    visible: IntArray
    found: IntArray


class PointCounts(NamedTuple):
    """Sums of tallies, as parallel arrays over points."""

    points: IntArray
    uids: IntArray
    visible: IntArray
    found: IntArray


class PointTallies:
    """Sums tallies up; takes no more room however long no keyframe is made."""

    def __init__(self, points: PointTable) -> None:
        self._points = points
        self._clear()

    def _clear(self) -> None:
        n = self._points.capacity
        self._uid: IntArray = self._points.uid.copy()
        self._visible: IntArray = np.zeros(n, np.int64)
        self._found: IntArray = np.zeros(n, np.int64)

    def add(self, tally: PointTally) -> None:
        """Add what one frame saw; counts of points that have left the map since are dropped."""
        uid = self._points.uid
        if len(uid) > len(self._uid):
            more = (0, len(uid) - len(self._uid))
            self._uid = np.pad(self._uid, more)
            self._visible, self._found = np.pad(self._visible, more), np.pad(self._found, more)
        other = self._uid != uid
        self._visible[other] = self._found[other] = 0
        self._uid[other] = uid[other]
        self._visible[tally.visible] += 1
        self._found[tally.found] += 1

    def take(self) -> PointCounts:
        """Return the sums and begin anew."""
        rows = np.flatnonzero(self._visible | self._found)
        counts = PointCounts(rows, self._uid[rows], self._visible[rows], self._found[rows])
        self._clear()
        return counts
