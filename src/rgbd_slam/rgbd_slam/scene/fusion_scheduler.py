"""Which images the dense map and the object tracks look at, and where those were taken."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.model.keyframe_poses import KeyframePoses

_EARLY_NS = 5_000_000  # stamps jitter


class FusionRequest(NamedTuple):
    """Where an image was taken, as the map said then."""

    stamp_ns: int
    T_map_camera: FloatArray  # (4, 4)
    reference_uid: int  # the keyframe that the pose hangs on
    keyframes: KeyframePoses | None  # as the map said then; None when not to be fused
    track_objects: bool = True  # whether to look for people and objects


class Rate:
    """Picks stamps at a rate."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NS_PER_S / rate_hz)
        self._last_ns: int | None = None

    def take_due(self, stamp_ns: int) -> bool:
        """Return whether a stamp is due; if so, count from it on."""
        last_ns = self._last_ns
        if last_ns is None or stamp_ns < last_ns - RESTART_NS:
            self._last_ns = stamp_ns
            return True
        grid_ns = last_ns + self._period_ns
        if stamp_ns < grid_ns - _EARLY_NS:
            return False
        on_time = 0 <= stamp_ns - grid_ns < self._period_ns
        self._last_ns = grid_ns if on_time else stamp_ns
        return True


class FusionScheduler:
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
        reference_uid: int,
        keyframes: Callable[[], KeyframePoses],
    ) -> FusionRequest | None:
        """Return what is to be known of an image, or None when nobody is to look at it.

        Args:
            stamp_ns: Of the image.
            T_map_camera: (4, 4), as the map says after tracking and mapping it.
            reference_uid: Of the keyframe that the pose hangs on.
            keyframes: Gives the keyframes as the map says then.
        """
        fuse = self._fuse is not None and self._fuse.take_due(stamp_ns)
        track_objects = self._look is not None and self._look.take_due(stamp_ns)
        if not fuse and not track_objects:
            return None
        known = keyframes() if fuse else None
        return FusionRequest(stamp_ns, T_map_camera, reference_uid, known, track_objects)
