"""The map points as a structure of arrays, and counts of the frames that observe them."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.records.soa_table import SoaTable

MAX_POSITION_M = 1e5  # chosen: largest coordinate of a pose or point in a map
_INITIAL_CAPACITY = 4096
_NOT_COUNTED = -2  # differs from the uid of any point and of an empty row


class PointTable(SoaTable):
    """The table of map points (index letter j). Only `Atlas` writes to the columns."""

    local: ClassVar[tuple[str, ...]] = (*SoaTable.local, 'shifted')

    def __init__(self) -> None:
        n = _INITIAL_CAPACITY
        super().__init__(n)
        self.position_m: FloatArray = np.zeros((n, 3))  # in the frame of the point's map
        # Unit vector: mean direction from the observing cameras to the point.
        self.view_direction: Float32Array = np.zeros((n, 3), np.float32)
        # Range of distances in which some octave can detect the point; see `point_statistics`.
        self.min_distance_m: Float32Array = np.zeros(n, np.float32)
        self.max_distance_m: Float32Array = np.zeros(n, np.float32)
        self.descriptors: ByteArray = np.zeros((n, 32), np.uint8)
        # Number of keyframes that observe it.
        self.num_observations: IntArray = np.zeros(n, np.int64)
        self.num_stereo: IntArray = np.zeros(n, np.int64)  # number of observations with depth
        self.num_visible: IntArray = np.zeros(n, np.int64)  # number of frames that should show it
        self.num_found: IntArray = np.zeros(n, np.int64)  # number of frames in which it was found
        # The keyframe that created the point; for a loaded point, its reference keyframe.
        self.first_keyframe_uid: IntArray = np.zeros(n, np.int64)
        # The keyframe whose octave and distance determine the range of distances.
        self.reference_keyframe_uid: IntArray = np.zeros(n, np.int64)
        self.map_id: IntArray = np.zeros(n, np.int64)
        # Version of the map at the last change of the position.
        self.shifted: IntArray = np.zeros(n, np.int64)


class PointTally(NamedTuple):
    """The points that a frame should show, and those that were found in it; none occurs twice."""

    visible: IntArray  # (V,) rows of the points that should be visible
    found: IntArray  # (M,) rows of the points that were found


class PointCounts(NamedTuple):
    """How many frames should have shown P points, and in how many they were found."""

    points: IntArray  # (P,) rows
    uids: IntArray  # (P,)
    visible: IntArray  # (P,) number of frames that should show the point
    found: IntArray  # (P,) number of frames in which the point was found


class PointTallies:
    """Counts since the last `take` how many frames should have shown points, and found them."""

    def __init__(self, points: PointTable) -> None:
        self._points = points
        # (capacity,) uid of the point that is counted in each row.
        self._uid: IntArray = np.empty(0, np.int64)
        self._visible = self._found = self._uid
        self._counted: list[IntArray] = []  # rows that were counted, maybe repeated

    def add(self, tally: PointTally) -> None:
        """Count the points of a frame. A row that was reused for a new point counts from 0."""
        if self._points.capacity > len(self._uid):
            more = (0, self._points.capacity - len(self._uid))
            self._uid = np.pad(self._uid, more, constant_values=_NOT_COUNTED)
            self._visible, self._found = np.pad(self._visible, more), np.pad(self._found, more)
        uid, rows = self._points.uid, np.concatenate([tally.visible, tally.found])
        new = rows[self._uid[rows] != uid[rows]]
        self._uid[new] = uid[new]
        self._visible[new] = self._found[new] = 0
        self._counted.append(new)
        self._visible[tally.visible] += 1
        self._found[tally.found] += 1

    def take(self) -> PointCounts:
        rows = np.unique(np.concatenate([np.empty(0, np.int64), *self._counted]))
        counts = PointCounts(rows, self._uid[rows], self._visible[rows], self._found[rows])
        self._uid[rows], self._counted = _NOT_COUNTED, []
        return counts
