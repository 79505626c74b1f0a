"""How often frames should have seen map points, and how often they did, between keyframes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import IntArray
from rgbd_slam.model.points import PointTable


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
