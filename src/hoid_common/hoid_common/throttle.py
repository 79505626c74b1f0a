"""Say the same thing once in a while, and how often it was left unsaid."""

from __future__ import annotations


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
