"""The stamp matcher on topics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.sync import Match, StampMatcher


class Synchronizer:
    """Calls back with messages that belong together, and keeps count of those that were dropped.

    Args:
        matcher: its streams are named as in the diagnostics, such as "colour", "depth".
        callback: gets the matched messages in the order of the matcher's streams.
    """

    def __init__(
        self, matcher: StampMatcher, callback: Callable[[Match], None], diagnostics: Diagnostics
    ) -> None:
        self._matcher = matcher
        self._callback = callback
        self._diagnostics = diagnostics

    def input(self, name: str) -> Callable[[Any], None]:
        """Return the callback of the subscription that feeds a stream."""

        def on_message(msg: Any) -> None:
            matches = self._matcher.add(name, stamp_from_msg(msg.header.stamp), msg)
            self._say_counts(name)
            for match in matches:
                self._callback(match)

        return on_message

    def _say_counts(self, name: str) -> None:
        counts = self._matcher.counts[name]
        dropped = counts.unmatched + counts.overflowed + counts.late
        self._diagnostics.set_count(f'{name} dropped', dropped)
