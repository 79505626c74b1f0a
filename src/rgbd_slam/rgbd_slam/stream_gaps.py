"""Images that never came, counted from the stamps of those that did."""

from __future__ import annotations

from collections import deque
from statistics import fmean

_WINDOW = 31
_MIN_INTERVALS = 5  # before that the stream's rate is not known


class StreamGaps:
    """Counts the images missing between two that came, at the stream's own rate."""

    def __init__(self) -> None:
        self.num_missing = 0
        self._last_ns: int | None = None
        self._intervals_ns: deque[float] = deque(maxlen=_WINDOW)

    def add(self, stamp_ns: int) -> None:
        """Take the next image's stamp; one that goes back starts the stream anew."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or stamp_ns <= last_ns:
            self._intervals_ns.clear()
            return
        interval_ns = float(stamp_ns - last_ns)
        if len(self._intervals_ns) >= _MIN_INTERVALS:
            missing = max(0, round(interval_ns / fmean(self._intervals_ns)) - 1)
            self.num_missing += missing
            interval_ns /= missing + 1  # jitter averages out, a gap would not
        self._intervals_ns.append(interval_ns)
