"""The time for which the camera has been lost, by stamps that may jump, repeat or start again."""

from __future__ import annotations

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, S_PER_NS

# Chosen: the part of a gap between two images that counts; during a longer one, no image was there
# in which the camera could have been found.
_MAX_GAP_NS = NS_PER_S // 2


class LossTimer:
    """Measures for how long images have arrived in which the camera was not found."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None  # since the stamps started
        self._lost_ns = 0

    def add(self, stamp_ns: int) -> bool:
        """Add the stamp of the next image, and return whether the stamps have started again.

        If they have, the measured time is set to zero.
        """
        newest_ns = self._newest_ns
        if newest_ns is None or stamp_ns < newest_ns - RESTART_NS:
            self._newest_ns, self._lost_ns = stamp_ns, 0
            return newest_ns is not None
        gap_ns = max(stamp_ns - newest_ns, 0)
        self._newest_ns = newest_ns + gap_ns
        self._lost_ns += min(gap_ns, _MAX_GAP_NS)
        return False

    def reset(self) -> None:
        """Measure from the latest image on, because the camera was found in it."""
        self._lost_ns = 0

    @property
    def lost_s(self) -> float:
        """Return the time [s] for which the camera has been lost."""
        return S_PER_NS * self._lost_ns
