"""The latest samples of one sensor of an IMU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, FloatArray, IntArray

# Chosen: longer than the 20 s in which rates and tracked rotations are compared.
_KEPT_NS = 25 * NS_PER_S
GAP_NS = NS_PER_S // 20
"""Samples that are more than this time [ns] apart leave a gap. Chosen: ten samples at 200 Hz."""
# Chosen: the first and the last sample count as valid for this time beyond their stamps.
_HELD_NS = NS_PER_S // 40
MAX_RATE_RADPS, MAX_FORCE_MPS2 = 100.0, 1000.0
"""No sensor measures more. Chosen: about three and four times the largest range of Bosch's BMI088
(BST-BMI088-DS001: 2000 degrees per second, 24 g)."""


class Samples(NamedTuple):
    """N samples of a gyro [rad/s] or an accelerometer [m/s^2] in order of time."""

    stamps_ns: IntArray  # (N,), increasing
    values: FloatArray  # (N, 3) along the axes of the IMU

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def cover(self, first_ns: int, last_ns: int) -> bool:
        """Return whether the samples have no gap of more than 50 ms between two times."""
        stamps_ns = self.stamps_ns
        if len(stamps_ns) < 2 or stamps_ns[0] - _HELD_NS > first_ns:
            return False
        return bool(stamps_ns[-1] + _HELD_NS >= last_ns and np.diff(stamps_ns).max() <= GAP_NS)


class SampleBuffer:
    """The samples of one sensor for at least 25 s, without those whose values exceed a limit."""

    def __init__(self, limit: float = np.inf) -> None:
        self._limit = limit
        self._samples = Samples(np.empty(0, np.int64), np.empty((0, 3)))
        self.num_impossible = 0  # number of dropped samples, whose values no sensor can measure

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def newest_ns(self) -> int | None:
        return int(self._samples.stamps_ns[-1]) if len(self) else None

    def add(self, samples: Samples) -> None:
        """Append samples, except late ones and those with impossible values.

        If the stamps go back by more than a second (as in a looped bag), old samples are dropped.
        """
        (stamps_ns, values), (known_ns, known) = samples, self._samples
        if not len(samples):
            return
        if len(known_ns) and stamps_ns[0] < known_ns[-1] - RESTART_NS:
            known_ns, known = known_ns[:0], known[:0]
        newest_ns = known_ns[-1] if len(known_ns) else np.iinfo(np.int64).min
        before_ns = np.maximum.accumulate(np.append(newest_ns, stamps_ns))[:-1]
        is_possible = (np.isfinite(values) & (np.abs(values) <= self._limit)).all(axis=1)
        self.num_impossible += int(np.count_nonzero(~is_possible))
        is_new = (stamps_ns > before_ns) & is_possible
        first = int(np.searchsorted(known_ns, stamps_ns.max() - _KEPT_NS))
        self._samples = Samples(
            np.append(known_ns[first:], stamps_ns[is_new]),
            np.concatenate([known[first:], values[is_new]]),
        )

    def before(self, stamp_ns: int, count: int) -> Samples:
        """Return the last samples up to a time, at most `count`."""
        stamps_ns, values = self._samples
        high = int(np.searchsorted(stamps_ns, stamp_ns, side='right'))
        part = slice(max(high - count, 0), high)
        return Samples(stamps_ns[part], values[part])

    def between(self, first_ns: int, second_ns: int) -> Samples:
        """Return the samples between two times, one sample before them and one after them."""
        stamps_ns, values = self._samples
        low = max(int(np.searchsorted(stamps_ns, first_ns, side='right')) - 1, 0)
        high = int(np.searchsorted(stamps_ns, second_ns)) + 1
        return Samples(stamps_ns[low:high], values[low:high])
