"""The number of dropped images, estimated from the stamps of those that arrived."""

from __future__ import annotations

from collections import deque
from statistics import fmean

from hoid_common.values import NS_PER_S

# Chosen, not tuned.
_WINDOW = 31  # intervals whose mean is the period of the stream: one second at 30 Hz
_MIN_INTERVALS = 5  # intervals from which on the period is known
# Number of equal gaps in a row from which they show a lower rate, as of a camera in the dark.
_NEW_RATE = 15
_PAUSE_NS = NS_PER_S  # a longer gap is a pause of the camera or the bag, in which no image is lost


class DroppedFrameCounter:
    """Counts the images that are missing at the rate of the stream.

    Stamps do not show whether a missing image was dropped or never taken. Therefore, if a stream
    skips the same number of images `_NEW_RATE` times in a row, it has a lower rate from then on.
    """

    def __init__(self) -> None:
        self.num_dropped = 0
        self._last_ns: int | None = None
        self._intervals_ns: deque[float] = deque(maxlen=_WINDOW)
        self._num_missing = 0  # images missing before the last one
        self._num_equal = 0  # successive gaps with this number of missing images

    def add(self, stamp_ns: int) -> None:
        """Add the stamp of the next image; an earlier stamp restarts the stream."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or not 0 < stamp_ns - last_ns <= _PAUSE_NS:
            self._restart()
            return
        interval_ns = float(stamp_ns - last_ns)
        if len(self._intervals_ns) >= _MIN_INTERVALS:
            num_missing = max(0, round(interval_ns / fmean(self._intervals_ns)) - 1)
            self.num_dropped += num_missing
            self._num_equal = self._num_equal + 1 if num_missing == self._num_missing else 1
            self._num_missing = num_missing
            if num_missing and self._num_equal == _NEW_RATE:
                self._restart()
                return
            interval_ns /= num_missing + 1  # so that gaps do not lengthen the mean interval
        self._intervals_ns.append(interval_ns)

    def _restart(self) -> None:
        self._intervals_ns.clear()
        self._num_missing = self._num_equal = 0
