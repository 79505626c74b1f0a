"""Changes of a map: the changed rows for its copies, and redirects of removed keyframes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.soa_table import SoaTableRows

# Chosen: more keyframes than can be removed while a request to the mapper is queued.
_MAX_REMEMBERED = 256


class Redirect(NamedTuple):
    """Replaces a removed keyframe, as the reference of relative poses, by its parent."""

    uid: int
    parent_uid: int
    T_parent_camera: FloatArray  # (4, 4) pose of the removed keyframe relative to its parent


class Connections(NamedTuple):
    """The keyframes that each of R keyframes shares points with."""

    rows: IntArray  # (R,)
    lengths: IntArray  # (R,) numbers of neighbors
    neighbors: IntArray  # (sum of lengths,) rows
    shared: IntArray  # (sum of lengths,) numbers of shared points


class MapChange(NamedTuple):
    """The difference between two versions of a map, to be applied to a copy."""

    version: int
    keyframes: SoaTableRows
    points: SoaTableRows
    connections: Connections  # of the keyframes whose shared points were counted again
    redirects: tuple[Redirect, ...]


class Redirects:
    """The redirects of a map: each is returned once by `take`; `resolve` knows the latest ones."""

    def __init__(self) -> None:
        self._to_take: list[Redirect] = []
        self._removed: deque[Redirect] = deque(maxlen=_MAX_REMEMBERED)

    def clear(self) -> None:
        """Delete all redirects, as the map is cleared."""
        self._to_take = []
        self._removed.clear()

    def add(self, redirects: Iterable[Redirect]) -> None:
        """Add the redirects of removed keyframes."""
        known = tuple(redirects)
        self._to_take.extend(known)
        self._removed.extend(known)

    def take(self) -> tuple[Redirect, ...]:
        """Return the redirects of the keyframes removed since the last call."""
        redirects, self._to_take = tuple(self._to_take), []
        return redirects

    def resolve(self, uid: int, T_keyframe_camera: FloatArray) -> tuple[int, FloatArray]:
        """Return the uid of the present reference, and the pose (4, 4) relative to it."""
        for redirect in self._removed:
            if redirect.uid == uid:
                uid = redirect.parent_uid
                T_keyframe_camera = redirect.T_parent_camera @ T_keyframe_camera
        return uid, T_keyframe_camera
