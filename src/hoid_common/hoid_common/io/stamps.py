"""Decimal seconds of text files to and from integer nanoseconds, with no float between."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

from hoid_common.values import NS_PER_S

_MAX_EXPONENT = 9  # of seconds; the digits of a larger one would fill memory
_MAX_STAMP_NS = 2**31 * NS_PER_S  # builtin_interfaces/Time has int32 seconds


def parse_stamp_ns(text: str) -> int:
    """Return the nanoseconds of decimal seconds.

    A float64 resolves only 240 ns at today's epoch, hence Decimal.

    Raises:
        ValueError: not a number, negative, or beyond what a ROS stamp holds.
    """
    try:
        stamp_s = Decimal(text)
        is_near = stamp_s.is_finite() and stamp_s.adjusted() <= _MAX_EXPONENT
        stamp_ns = int((stamp_s * NS_PER_S).to_integral_value()) if is_near else -1
    except InvalidOperation as error:
        raise ValueError(f'"{text}" is not a time in seconds') from error
    if not 0 <= stamp_ns < _MAX_STAMP_NS:
        raise ValueError(f'"{text}" s is outside what a ROS stamp holds (0 to 2^31 s)')
    return stamp_ns


def format_stamp_s(stamp_ns: int) -> str:
    """Return decimal seconds with nine decimals, the inverse of `parse_stamp_ns`."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return f'{seconds}.{nanoseconds:09d}'
