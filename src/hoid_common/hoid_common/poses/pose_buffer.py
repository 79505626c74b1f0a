"""Interpolation between stamped poses; tf2's buffer does not extrapolate, and wheels lack it."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray

_KEPT_NS = 10 * NS_PER_S  # the duration that tf2's buffer keeps by default
# Chosen, not tuned: a pose is given for stamps that are later than the newest pose by up to this
# time, because an image may arrive before the odometry message that follows its stamp.
_MAX_EXTRAPOLATION_NS = NS_PER_S // 5


class PoseBuffer:
    """Timestamped poses of one frame in another, of the ten seconds up to the newest pose."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, FloatArray]] = deque()  # stamp, T (4, 4)

    def add(self, stamp_ns: int, T: FloatArray) -> None:
        """Append a pose T (4, 4); one with an older stamp drops all others."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            if stamp_ns == self._poses[-1][0]:  # a repeated message
                return
            self._poses.clear()  # the clock was set back, as when a bag is played again
        self._poses.append((stamp_ns, T))
        while self._poses[0][0] < stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> FloatArray | None:
        """Return the pose T (4, 4) at a time, interpolated with constant twist; None if unknown.

        Up to 0.2 s after the newest pose the last motion is extrapolated.
        """
        after = bisect_left(self._poses, stamp_ns, key=lambda pose: pose[0])
        if after < len(self._poses) and self._poses[after][0] == stamp_ns:
            return self._poses[after][1]
        if after == len(self._poses):
            if not self._poses or stamp_ns - self._poses[-1][0] > _MAX_EXTRAPOLATION_NS:
                return None
            after -= 1
        if after == 0:
            return None
        (first_ns, T_first), (second_ns, T_second) = self._poses[after - 1], self._poses[after]
        share = (stamp_ns - first_ns) / (second_ns - first_ns)
        return T_first @ se3.exp(share * se3.log(se3.inverse(T_first) @ T_second))
