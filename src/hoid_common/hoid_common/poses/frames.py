"""The frame tree of a robot: static transforms, and stamped poses of moving frames."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.values import NS_PER_S, FloatArray

_MAX_DEPTH = 64  # chosen: no robot has longer chains of frames; a longer chain is a cycle
# Chosen far above the number of frames of a robot: further frames are refused. Without a limit, a
# publisher that changes the frame name in every message would fill the memory.
_MAX_FRAMES = 1000
_KEPT_NS = 10 * NS_PER_S  # poses older than this are dropped; tf2's buffer has the same default
# Chosen, not tuned: a pose is extrapolated to stamps that are later than the newest pose by up to
# this time, because an image may arrive before the next odometry message.
_MAX_EXTRAPOLATION_NS = NS_PER_S // 5


def check_frame_limit(what: str, name: str, number: int, limit: int) -> None:
    if number >= limit:
        raise MessageError(
            f'{what}: frame "{name}" exceeds the limit of {limit} frames; '
            'check whether its publisher changes the frame name in every message'
        )


class StaticFrames:
    """A tree of static transforms, which returns the transform between any two of its frames."""

    def __init__(self) -> None:
        self._edges: dict[str, tuple[str, FloatArray]] = {}  # by child: parent, T_parent_child

    def add(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Set parent and T_parent_child (4, 4) of a frame; MessageError for too many frames."""
        if child not in self._edges:
            check_frame_limit('static frames', child, len(self._edges), _MAX_FRAMES)
        self._edges[child] = parent, T_parent_child

    def with_edges(self, edges: Iterable[tuple[str, str, FloatArray]]) -> StaticFrames:
        """Return a copy with further edges (parent, child, T_parent_child)."""
        tree = StaticFrames()
        tree._edges = dict(self._edges)
        for edge in edges:
            tree.add(*edge)
        return tree

    def find(self, a: str, b: str) -> FloatArray | None:
        """Return T_a_b (4, 4); None if the tree does not connect them, identity if a is b."""
        to_root_of_a = dict(self._ancestors(a))
        for frame, T_frame_b in self._ancestors(b):
            if frame in to_root_of_a:
                return se3.inverse(to_root_of_a[frame]) @ T_frame_b
        return None

    def _ancestors(self, frame: str) -> Iterator[tuple[str, FloatArray]]:
        """Yield the frame and at most 63 of its ancestors, each with T_ancestor_frame (4, 4)."""
        T = np.eye(4)
        for _ in range(_MAX_DEPTH):
            yield frame, T
            if frame not in self._edges:
                return
            frame, T_parent_child = self._edges[frame]
            T = T_parent_child @ T


class PoseBuffer:
    """The poses of one frame in another with their stamps; older than ten seconds are dropped."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, FloatArray]] = deque()  # stamp, T (4, 4)

    def add(self, stamp_ns: int, T: FloatArray) -> None:
        """Append a pose T (4, 4); a pose with an older stamp first discards all stored poses."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            if stamp_ns == self._poses[-1][0]:  # a repeated message
                return
            self._poses.clear()  # the clock was set back, as when a bag is played again
        self._poses.append((stamp_ns, T))
        while self._poses[0][0] < stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> FloatArray | None:
        """Return the pose T (4, 4) at a time, interpolated with constant twist; None if unknown.

        The last motion is extrapolated up to 0.2 s beyond the newest pose.
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
