"""Say the same thing once in a while: how often it was left unsaid, or ever more seldom."""

from __future__ import annotations

from collections.abc import Collection


class Throttle:
    """Let one message of each kind through per period, and count the others."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s: dict[str, float] = {}
        self._skipped: dict[str, int] = {}

    def allow(self, kind: str, now_s: float) -> int | None:
        """Return how many of the kind were held back before, or None to hold this one back."""
        if now_s < self._next_s.get(kind, now_s):
            self._skipped[kind] = self._skipped.get(kind, 0) + 1
            return None
        self._next_s[kind] = now_s + self._period_s
        return self._skipped.pop(kind, 0)


class Backoff:
    """Let what stands be said at once, and again after waits that double up to the longest."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._wait_s: dict[str, float] = {}  # until the next time
        self._next_s: dict[str, float] = {}

    def due(self, standing: Collection[str], now_s: float) -> list[str]:
        """Return what of all that stands now is to be said; what stood before begins anew."""
        self._wait_s = {kind: self._wait_s[kind] for kind in standing if kind in self._wait_s}
        due = [k for k in standing if k not in self._wait_s or now_s >= self._next_s[k]]
        for kind in due:
            wait_s = self._wait_s.get(kind, self._first_s)
            self._next_s[kind] = now_s + wait_s
            self._wait_s[kind] = min(2 * wait_s, self._longest_s)
        return due
