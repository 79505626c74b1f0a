"""Images that never came, counted from the stamps of those that did."""

from __future__ import annotations

from collections import deque
from statistics import fmean

from hoid_common.values import NS_PER_S

_WINDOW = 31
_MIN_INTERVALS = 5  # before that the stream's rate is not known
_NEW_RATE = 15  # equal gaps in a row: the camera has slowed down, as in the dark
_PAUSE_NS = NS_PER_S  # a camera or bag that stood still has dropped nothing


class StreamGaps:
    """Counts the images missing between two that came, at the stream's own rate.

    Stamps do not say who lost an image, nor whether it was ever taken: a stream that skips the
    same number of images `_NEW_RATE` times in a row is a slower one from then on, and one without
    an image for more than a second begins anew.
    """

    def __init__(self) -> None:
        self.num_missing = 0
        self._last_ns: int | None = None
        self._intervals_ns: deque[float] = deque(maxlen=_WINDOW)
        self._missing = self._num_equal = 0  # before the last image, and how often in a row

    def add(self, stamp_ns: int) -> None:
        """Take the next image's stamp; one that goes back starts the stream anew."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or not 0 < stamp_ns - last_ns <= _PAUSE_NS:
            self._begin()
            return
        interval_ns = float(stamp_ns - last_ns)
        if len(self._intervals_ns) >= _MIN_INTERVALS:
            missing = max(0, round(interval_ns / fmean(self._intervals_ns)) - 1)
            self.num_missing += missing
            self._num_equal = self._num_equal + 1 if missing == self._missing else 1
            self._missing = missing
            if missing and self._num_equal == _NEW_RATE:
                self._begin()
                return
            interval_ns /= missing + 1  # jitter averages out, a gap would not
        self._intervals_ns.append(interval_ns)

    def _begin(self) -> None:
        self._intervals_ns.clear()
        self._missing = self._num_equal = 0
