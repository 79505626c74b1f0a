"""The latest samples of one sensor of an IMU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, FloatArray, IntArray

_KEPT_NS = 40 * NS_PER_S  # chosen: longer than the tracked motions that samples are compared with
_INITIAL_CAPACITY = 1024
GAP_NS = NS_PER_S // 20
"""Samples that are more than this time [ns] apart leave a gap. Chosen: ten samples at 200 Hz."""
MAX_RATE_RADPS, MAX_FORCE_MPS2 = 100.0, 1000.0
"""No sensor measures more. Chosen: about three and four times the largest range of Bosch's BMI088
(BST-BMI088-DS001: 2000 degrees per second, 24 g)."""


class Samples(NamedTuple):
    """N samples of a gyro [rad/s] or an accelerometer [m/s^2] in order of time."""

    stamps_ns: IntArray  # (N,), increasing
    values: FloatArray  # (N, 3) along the axes of the IMU

    def __len__(self) -> int:
        return len(self.stamps_ns)


class SampleBuffer:
    """The samples of at least the last 40 s of one sensor, in order of time.

    Args:
        limit: Samples of which a value is larger are dropped.
    """

    def __init__(self, limit: float = np.inf) -> None:
        self._limit = limit
        self._stamps_ns = np.empty(_INITIAL_CAPACITY, np.int64)
        self._values = np.empty((_INITIAL_CAPACITY, 3))
        self._first = self._end = 0
        # Samples that were dropped because one as new or newer had arrived before.
        self.num_late = 0
        self.num_impossible = 0  # samples that were dropped because no sensor measures that
        self.num_gaps = 0  # pauses between successive samples that are longer than `GAP_NS`

    def __len__(self) -> int:
        return self._end - self._first

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest sample; None if there is none."""
        return int(self._stamps_ns[self._end - 1]) if len(self) else None

    def add(self, samples: Samples) -> None:
        """Append samples. Late ones are dropped, and those that no sensor measures.

        The latter are not finite, or beyond the limit; `num_impossible` counts them. A sample is
        late if its stamp is not later than all stamps before it; `num_late` counts these samples.
        If the stamps have gone back by more than a second, as when a bag is played in a loop, the
        old samples are dropped instead.
        """
        stamps_ns, values = samples
        newest_ns = self.newest_ns
        if newest_ns is not None and len(samples) and stamps_ns[0] < newest_ns - RESTART_NS:
            self._first = self._end = 0
            newest_ns = None
        floor_ns = np.iinfo(np.int64).min if newest_ns is None else newest_ns
        before_ns = np.maximum.accumulate(np.append(floor_ns, stamps_ns))[:-1]
        is_possible = (np.isfinite(values) & (np.abs(values) <= self._limit)).all(axis=1)
        is_new = (stamps_ns > before_ns) & is_possible
        self.num_impossible += int(np.count_nonzero(~is_possible))
        self.num_late += int(np.count_nonzero(stamps_ns <= before_ns))
        stamps_ns, values = stamps_ns[is_new], values[is_new]
        known_ns = stamps_ns if newest_ns is None else np.append(newest_ns, stamps_ns)
        self.num_gaps += int(np.count_nonzero(np.diff(known_ns) > GAP_NS))
        self._reserve(len(stamps_ns))
        end = self._end + len(stamps_ns)
        self._stamps_ns[self._end : end], self._values[self._end : end] = stamps_ns, values
        self._end = end

    def between(self, first_ns: int, second_ns: int) -> Samples:
        """Return the samples from the last one up to `first_ns` to the first from `second_ns` on.

        At an end where there is none, the samples begin later or end earlier. The arrays are views
        and are valid until the next `add`.
        """
        used = self._stamps_ns[self._first : self._end]
        low = max(int(np.searchsorted(used, first_ns, side='right')) - 1, 0) + self._first
        high = int(np.searchsorted(used, second_ns)) + 1 + self._first
        part = slice(low, min(high, self._end))
        return Samples(self._stamps_ns[part], self._values[part])

    def _reserve(self, count: int) -> None:
        """Make room for samples; drop those that are too old whenever the array is full."""
        if self._end + count <= len(self._stamps_ns):
            return
        used = slice(self._first, self._end)
        stamps_ns, values = self._stamps_ns[used], self._values[used]
        if len(stamps_ns):
            kept = int(np.searchsorted(stamps_ns, stamps_ns[-1] - _KEPT_NS))
            stamps_ns, values = stamps_ns[kept:].copy(), values[kept:].copy()
        capacity = max(2 * (len(stamps_ns) + count), _INITIAL_CAPACITY)
        self._stamps_ns, self._values = np.empty(capacity, np.int64), np.empty((capacity, 3))
        self._first, self._end = 0, len(stamps_ns)
        self._stamps_ns[: self._end], self._values[: self._end] = stamps_ns, values
