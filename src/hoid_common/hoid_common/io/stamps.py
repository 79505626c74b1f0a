"""Stamps of recordings: exact conversion from and to text, and sorting by time."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, IntArray

_MAX_EXPONENT = 9  # 2^31 s < 10^10 s; "1e999999999" would fill the memory with digits
END_STAMP_NS = 2**31 * NS_PER_S
"""First stamp beyond the range of ROS: the seconds of builtin_interfaces/Time are int32."""


def parse_stamp_ns(text: str) -> int:
    """Return the stamp in ns of a text with decimal seconds, rounded to the nearest nanosecond.

    The text is read as Decimal, because a float64 resolves only 240 ns at today's epoch.
    ValueError if the text is no number, or outside the range of ROS stamps.
    """
    try:
        stamp_s = Decimal(text)
        is_in_range = stamp_s.is_finite() and stamp_s.adjusted() <= _MAX_EXPONENT
        stamp_ns = int((stamp_s * NS_PER_S).to_integral_value()) if is_in_range else -1
    except InvalidOperation as error:
        raise ValueError(f'"{text}" is not a time in seconds') from error
    if not 0 <= stamp_ns < END_STAMP_NS:
        raise ValueError(f'"{text}" s is outside the range of a ROS stamp (0 to 2^31 s)')
    return stamp_ns


class OrderedStamps(NamedTuple):
    """The distinct stamps of a stream in order of time."""

    stamps_ns: IntArray  # (M,), increasing
    # (M,) index of each stamp in the stream; of a repeated stamp, its first index.
    positions: IntArray
    num_repeated: int  # items left out because their stamp was there before
    num_late: int  # items that came after a newer one

    def __str__(self) -> str:
        parts = (
            (self.num_repeated, 'repeated stamps left out'),
            (self.num_late, 'late stamps sorted in'),
        )
        return ', '.join(f'{what}: {number}' for number, what in parts if number)


def in_order(stamps_ns: Sequence[int] | IntArray) -> OrderedStamps:
    """Return the (N,) stamps of a stream in order of time, without repetitions."""
    given = np.asarray(stamps_ns, np.int64)
    unique, index = np.unique(given, return_index=True)
    num_late = int((given < np.maximum.accumulate(given)).sum()) if len(given) else 0
    return OrderedStamps(unique, index, len(given) - len(unique), num_late)


def longest_pass(stamps_ns: Sequence[int] | IntArray) -> slice:
    """Return the longest slice of stamps in which time does not restart, as in a looped bag."""
    given = np.asarray(stamps_ns, np.int64)
    starts, newest_ns = [0], given[0] if len(given) else 0
    for i, stamp_ns in enumerate(given.tolist()):
        if newest_ns - stamp_ns >= RESTART_NS:
            starts.append(i)
            newest_ns = stamp_ns
        newest_ns = max(newest_ns, stamp_ns)
    ends = [*starts[1:], len(given)]
    return max(
        (slice(a, b) for a, b in zip(starts, ends, strict=True)), key=lambda s: s.stop - s.start
    )


def format_stamp_s(stamp_ns: int) -> str:
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return f'{seconds}.{nanoseconds:09d}'
