"""Which images the dense map and the object tracks look at, and where those were taken."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray, Trajectory

_NS = 1_000_000_000
_EARLY_NS = 5_000_000  # stamps jitter
_RESTART_NS = _NS  # a stamp that much older means that time started anew


class FramePose(NamedTuple):
    """Where an image was taken, as the map said then."""

    stamp_ns: int
    T_map_camera: FloatArray  # (4, 4)
    keyframes: Trajectory | None  # as the map said then; None when the image is not to be fused
    follow: bool = True  # whether to look for people and objects


class Rate:
    """Picks stamps at a rate."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(_NS / rate_hz)
        self._last_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether a stamp is due."""
        if self._last_ns is None or stamp_ns < self._last_ns - _RESTART_NS:
            return True
        return stamp_ns >= self._last_ns + self._period_ns - _EARLY_NS

    def take(self, stamp_ns: int) -> None:
        """Count from a stamp on."""
        grid_ns = stamp_ns if self._last_ns is None else self._last_ns + self._period_ns
        on_time = 0 <= stamp_ns - grid_ns < self._period_ns
        self._last_ns = grid_ns if on_time else stamp_ns


class FramePoses:
    """Picks the images to look at.

    Args:
        fuse_rate_hz: Of images to fuse into the dense map; None for none.
        look_rate_hz: Of images to look for objects in; None for none.
    """

    def __init__(self, fuse_rate_hz: float | None, look_rate_hz: float | None) -> None:
        self._fuse = None if fuse_rate_hz is None else Rate(fuse_rate_hz)
        self._look = None if look_rate_hz is None else Rate(look_rate_hz)

    def pick(
        self,
        stamp_ns: int,
        T_map_camera: FloatArray,
        keyframes: Callable[[], Trajectory],
        *,
        is_keyframe: bool,
    ) -> FramePose | None:
        """Return what is to be known of an image, or None when nobody is to look at it.

        Args:
            stamp_ns: Of the image.
            T_map_camera: (4, 4), as tracked.
            keyframes: Gives the keyframes as the map says after tracking.
            is_keyframe: Whether the image became one; the map may have been corrected by it, and
                then only the keyframe itself tells where it is.
        """
        fused = None
        if self._fuse is not None and self._fuse.is_due(stamp_ns):
            fused = _placed(stamp_ns, T_map_camera, keyframes(), is_keyframe=is_keyframe)
        if self._fuse is not None and fused is not None:
            self._fuse.take(stamp_ns)
        if self._look is not None and self._look.is_due(stamp_ns):
            self._look.take(stamp_ns)
            return fused or FramePose(stamp_ns, T_map_camera, None)
        return None if fused is None else fused._replace(follow=False)


def _placed(
    stamp_ns: int, T_map_camera: FloatArray, keyframes: Trajectory, *, is_keyframe: bool
) -> FramePose | None:
    if not is_keyframe:
        return FramePose(stamp_ns, T_map_camera, keyframes) if len(keyframes) else None
    at = np.flatnonzero(keyframes.stamps_ns == stamp_ns)
    if len(at) == 0:
        return None  # still on its way into the map, or redundant
    return FramePose(stamp_ns, keyframes.T_world_camera[at[0]], keyframes)
