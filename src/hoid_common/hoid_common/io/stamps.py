"""Exact conversion between decimal seconds in text files and integer nanoseconds."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

from hoid_common.values import NS_PER_S

_MAX_EXPONENT = 9  # 2^31 s < 10^10 s; "1e999999999" would fill the memory with digits
_MAX_STAMP_NS = 2**31 * NS_PER_S  # the seconds of builtin_interfaces/Time are int32


def parse_stamp_ns(text: str) -> int:
    """Return the nanoseconds of a text with decimal seconds, rounded to the nearest one.

    It is parsed as a Decimal, because a float64 resolves only 240 ns at today's epoch.

    Raises:
        ValueError: The text is no number, negative, or beyond the range of a ROS stamp.
    """
    try:
        stamp_s = Decimal(text)
        is_in_range = stamp_s.is_finite() and stamp_s.adjusted() <= _MAX_EXPONENT
        stamp_ns = int((stamp_s * NS_PER_S).to_integral_value()) if is_in_range else -1
    except InvalidOperation as error:
        raise ValueError(f'"{text}" is not a time in seconds') from error
    if not 0 <= stamp_ns < _MAX_STAMP_NS:
        raise ValueError(f'"{text}" s is outside the range of a ROS stamp (0 to 2^31 s)')
    return stamp_ns


def format_stamp_s(stamp_ns: int) -> str:
    """Return decimal seconds with nine decimals, the inverse of `parse_stamp_ns`."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return f'{seconds}.{nanoseconds:09d}'
