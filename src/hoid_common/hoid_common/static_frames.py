"""The static part of a robot's frame tree: where one frame sits on another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.values import FloatArray

_MAX_DEPTH = 64  # a longer chain is a loop
_MAX_FRAMES = 1000  # who names more of them makes names up


def check_number(what: str, name: str, number: int, limit: int) -> None:
    """Raise MessageError when a limited number of frames has no place for one more."""
    if number >= limit:
        raise MessageError(f'{what}: "{name}" is one more than {limit}; does its name change?')


class StaticFrames:
    """Collects edges and answers `T_a_b` for any two frames of one tree."""

    def __init__(self) -> None:
        self._edges: dict[str, tuple[str, FloatArray]] = {}  # child: parent, T_parent_child

    def add(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Take an edge in; the latest for a child counts.

        Raises:
            MessageError: It is one more than a robot has.
        """
        if child not in self._edges:
            check_number('static frames', child, len(self._edges), _MAX_FRAMES)
        self._edges[child] = parent, T_parent_child

    def with_edges(self, edges: Iterable[tuple[str, str, FloatArray]]) -> StaticFrames:
        """Return a tree with edges (parent, child, T_parent_child) that hold now as well."""
        tree = StaticFrames()
        tree._edges = dict(self._edges)
        for edge in edges:
            tree.add(*edge)
        return tree

    def find(self, a: str, b: str) -> FloatArray | None:
        """Return T_a_b (4, 4), or None when no chain of known edges joins the two."""
        to_root_of_a = dict(self._ancestors(a))
        for frame, T_frame_b in self._ancestors(b):
            if frame in to_root_of_a:
                return se3.inverse(to_root_of_a[frame]) @ T_frame_b
        return None

    def _ancestors(self, frame: str) -> Iterator[tuple[str, FloatArray]]:
        """Yield the frame and all above it, each with T_ancestor_frame."""
        T = np.eye(4)
        for _ in range(_MAX_DEPTH):
            yield frame, T
            if frame not in self._edges:
                return
            frame, T_parent_child = self._edges[frame]
            T = T_parent_child @ T
