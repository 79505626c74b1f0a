"""How time passes from one image to the next, by stamps that may leap, stand still or go back."""

from __future__ import annotations

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, S_PER_NS

_MOST_NS = NS_PER_S // 2  # of a gap: in a longer one nobody has looked


class ImageClock:
    """Counts for how long images have come of which none was recognised."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None  # since time started
        self._lost_ns = 0

    def add(self, stamp_ns: int) -> bool:
        """Take the next image's stamp; return whether time started anew with it."""
        newest_ns = self._newest_ns
        if newest_ns is None or stamp_ns < newest_ns - RESTART_NS:
            self._newest_ns, self._lost_ns = stamp_ns, 0
            return newest_ns is not None
        gap_ns = max(stamp_ns - newest_ns, 0)
        self._newest_ns = newest_ns + gap_ns
        self._lost_ns += min(gap_ns, _MOST_NS)
        return False

    def recognised(self) -> None:
        """Count from the latest image on."""
        self._lost_ns = 0

    @property
    def lost_s(self) -> float:
        """Return for how long images have come since one was recognised, or since the first."""
        return S_PER_NS * self._lost_ns
