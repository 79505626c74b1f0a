"""Rate limits for log lines of one kind: at a fixed period, or with exponential back-off."""

from __future__ import annotations

import math
from collections.abc import Collection


class LogThrottle:
    """Allows one message of each kind per period, and counts the messages that it suppresses."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s: dict[str, float] = {}
        self._skipped: dict[str, int] = {}

    def allow(self, kind: str, now_s: float) -> int | None:
        """Return None if a message must not be logged, else how many were suppressed before it."""
        if now_s < self._next_s.get(kind, now_s):
            self._skipped[kind] = self._skipped.get(kind, 0) + 1
            return None
        self._next_s[kind] = now_s + self._period_s
        return self._skipped.pop(kind, 0)


class Backoff:
    """Reports a lasting problem at once, then at intervals that double up to a limit."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._reported_s: dict[str, float] = {}  # time of the last report
        # Of active problems: time from the last report to the next.
        self._interval_s: dict[str, float] = {}

    def due(self, active: Collection[str], now_s: float) -> list[str]:
        """Return the active problems that are due for a report; the others count as resolved."""
        self._interval_s = {kind: self._interval_s.get(kind, 0.0) for kind in active}
        due = [
            kind
            for kind, interval_s in self._interval_s.items()
            if now_s >= self._reported_s.get(kind, -math.inf) + max(interval_s, self._first_s)
        ]
        for kind in due:
            self._reported_s[kind] = now_s
            doubled_s = max(2 * self._interval_s[kind], self._first_s)
            self._interval_s[kind] = min(doubled_s, self._longest_s)
        return due
