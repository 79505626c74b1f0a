"""Poses that come one by one, asked for at times between them."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray

_KEPT_NS = 10 * NS_PER_S
_AHEAD_NS = NS_PER_S // 5  # to which the last motion is taken to go on


class PoseBuffer:
    """Keeps the poses of the last ten seconds, in the order of their stamps."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, FloatArray]] = deque()  # stamp, T (4, 4)

    def add(self, stamp_ns: int, T: FloatArray) -> None:
        """Take a pose in; one that is not newer than the newest starts anew."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            if stamp_ns == self._poses[-1][0]:  # said twice
                return
            self._poses.clear()  # the clock was set back
        self._poses.append((stamp_ns, T))
        while self._poses[0][0] < stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> FloatArray | None:
        """Return T (4, 4) between the two poses around a time, at even speed.

        For a fifth of a second beyond the newest, the last motion goes on; None where nothing is
        known.
        """
        after = bisect_left(self._poses, stamp_ns, key=lambda pose: pose[0])
        if after < len(self._poses) and self._poses[after][0] == stamp_ns:
            return self._poses[after][1]
        if after == len(self._poses):
            if not self._poses or stamp_ns - self._poses[-1][0] > _AHEAD_NS:
                return None
            after -= 1
        if after == 0:
            return None
        (first_ns, T_first), (second_ns, T_second) = self._poses[after - 1], self._poses[after]
        share = (stamp_ns - first_ns) / (second_ns - first_ns)
        return T_first @ se3.exp(share * se3.log(se3.inverse(T_first) @ T_second))
