"""The stamp matcher on topics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from std_msgs.msg import Header

from hoid_common.errors import HoidError
from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.sync import Match, StampMatcher


class Stamped(NamedTuple):
    """What was made of a message, with its header."""

    header: Header
    value: Any


class Synchronizer:
    """Calls back with what belongs together, and keeps count of what was dropped.

    Args:
        matcher: its streams are named as in the diagnostics, such as "colour", "depth".
        callback: gets a match of `Stamped` values; may raise HoidError, which is counted and
            logged, and the next match comes all the same.
    """

    def __init__(
        self, matcher: StampMatcher, callback: Callable[[Match], None], diagnostics: Diagnostics
    ) -> None:
        self._matcher = matcher
        self._callback = callback
        self._diagnostics = diagnostics

    def input(self, name: str, convert: Callable[[Any], Any]) -> Callable[[Any], None]:
        """Return the callback of the subscription that feeds a stream.

        Args:
            name: the stream.
            convert: called with each message before it is matched, so that what it raises is
                said of this stream and not of the one that completes the match.
        """

        def on_message(msg: Any) -> None:
            value = Stamped(msg.header, convert(msg))
            matches = self._matcher.add(name, stamp_from_msg(msg.header.stamp), value)
            self._say_counts(name)
            for match in matches:
                self._call(match)

        return on_message

    def _call(self, match: Match) -> None:
        try:
            self._callback(match)
        except HoidError as error:
            self._diagnostics.report(error, 'matched images refused')

    def _say_counts(self, name: str) -> None:
        counts = self._matcher.counts[name]
        dropped = counts.unmatched + counts.overflowed + counts.late
        self._diagnostics.set_count(f'{name} dropped', dropped)
