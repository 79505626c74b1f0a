"""Say the same thing once in a while: how often it was left unsaid, or ever more seldom."""

from __future__ import annotations

import math
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
    """Let what stands be said at once, and again after waits that double up to the longest.

    What was gone in between begins anew, but is never said sooner than after the first wait.
    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._said_s: dict[str, float] = {}
        self._wait_s: dict[str, float] = {}  # of what stands: before it is said again

    def due(self, standing: Collection[str], now_s: float) -> list[str]:
        """Return what of all that stands now is to be said."""
        self._wait_s = {kind: self._wait_s.get(kind, 0.0) for kind in standing}
        due = [kind for kind in standing if now_s >= self._earliest_s(kind)]
        for kind in due:
            self._said_s[kind] = now_s
            self._wait_s[kind] = min(max(2 * self._wait_s[kind], self._first_s), self._longest_s)
        return due

    def _earliest_s(self, kind: str) -> float:
        if kind not in self._said_s:
            return -math.inf
        return self._said_s[kind] + max(self._wait_s[kind], self._first_s)
