"""What changed in a map since: rows for its copies, and what hangs elsewhere now."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from hoid_common.values import FloatArray
from rgbd_slam.model.soa_table import SoaTableRows

_REMEMBERED = 256  # removed keyframes: more than can be removed while a request is under way


class Redirect(NamedTuple):
    """Where the poses that were relative to a removed keyframe hang now."""

    uid: int
    parent_uid: int
    T_parent_camera: FloatArray  # (4, 4), camera of the removed keyframe


class MapChange(NamedTuple):
    """What brings a copy of the map up to date."""

    version: int
    keyframes: SoaTableRows
    points: SoaTableRows
    redirects: tuple[Redirect, ...]


class Redirects:
    """Those of a map: each is handed out once, and the last ones are remembered."""

    def __init__(self) -> None:
        self._to_take: list[Redirect] = []
        self._removed: deque[Redirect] = deque(maxlen=_REMEMBERED)

    def clear(self) -> None:
        """Forget all, with the map."""
        self._to_take = []
        self._removed.clear()

    def add(self, redirects: Iterable[Redirect]) -> None:
        """Take note of removed keyframes."""
        known = tuple(redirects)
        self._to_take.extend(known)
        self._removed.extend(known)

    def take(self) -> tuple[Redirect, ...]:
        """Return, once, the redirects of keyframes removed since the last call."""
        redirects, self._to_take = tuple(self._to_take), []
        return redirects

    def resolve(self, uid: int, T_keyframe_camera: FloatArray) -> tuple[int, FloatArray]:
        """Return where a pose (4, 4) hangs now that was given relative to a keyframe."""
        for redirect in self._removed:
            if redirect.uid == uid:
                uid = redirect.parent_uid
                T_keyframe_camera = redirect.T_parent_camera @ T_keyframe_camera
        return uid, T_keyframe_camera
