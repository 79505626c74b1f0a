"""Synchronization of subscriptions by the stamps of their messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from std_msgs.msg import Header

from hoid_common.errors import HoidError
from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.sync import Match, StampMatcher


class Stamped(NamedTuple):
    """The converted content of a message, with the message's header."""

    header: Header
    value: Any


class Synchronizer:
    """Calls a function for each match of messages, and counts the dropped ones in diagnostics.

    While messages do not match, or probably the wrong ones do, there is a problem. A HoidError of
    the callback is counted and logged.
    """

    def __init__(
        self, matcher: StampMatcher, callback: Callable[[Match], None], diagnostics: Diagnostics
    ) -> None:
        self._matcher = matcher
        self._callback = callback
        self._diagnostics = diagnostics

    def input(self, name: str, convert: Callable[[Any], Any]) -> Callable[[Any], None]:
        """Return the subscription callback of a stream; `convert` runs before matching."""

        def on_message(msg: Any) -> None:
            value = Stamped(msg.header, convert(msg))
            matches = self._matcher.add(name, stamp_from_msg(msg.header.stamp), value)
            self._update_counts(name)
            for match in matches:
                self._call(match)

        return on_message

    def _call(self, match: Match) -> None:
        try:
            self._callback(match)
        except HoidError as error:
            self._diagnostics.report(error, 'matched images refused')

    def _update_counts(self, name: str) -> None:
        counts = self._matcher.counts[name]
        dropped = counts.unmatched + counts.overflowed + counts.late
        self._diagnostics.set_count(f'{name} dropped', dropped)
        self._diagnostics.report_problem('stamps', self._matcher.mismatch)
