"""The static part of a robot's frame tree, and transforms between any two of its frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.values import FloatArray

_MAX_DEPTH = 64  # chosen: no robot has longer chains, so that a longer one is a cycle
# Chosen far above what a robot has: further frames are refused. Without a limit, a publisher that
# changes the frame name in every message would fill the memory.
_MAX_FRAMES = 1000


def check_frame_limit(what: str, name: str, number: int, limit: int) -> None:
    if number >= limit:
        raise MessageError(
            f'{what}: frame "{name}" exceeds the limit of {limit} frames; '
            'check whether its publisher changes the frame name in every message'
        )


class StaticFrames:
    """A tree of static transforms, from which the transform between any two frames is found."""

    def __init__(self) -> None:
        self._edges: dict[str, tuple[str, FloatArray]] = {}  # child: parent, T_parent_child

    def add(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Set the parent of `child` and T_parent_child (4, 4); MessageError for too many."""
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
        """Yield the frame and its ancestors, each with T_ancestor_frame; at most 64 in a cycle."""
        T = np.eye(4)
        for _ in range(_MAX_DEPTH):
            yield frame, T
            if frame not in self._edges:
                return
            frame, T_parent_child = self._edges[frame]
            T = T_parent_child @ T
