"""Put together what belongs to one instant: items of several streams, matched by their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

# A stamp this much older than the last one means that time started anew: a bag that loops, a clock
# that was set.
RESTART_NS = 1_000_000_000


class _Item(NamedTuple):
    stamp_ns: int
    value: Any


# Answers in place of a partner.
_WAIT = _Item(-1, 'wait')
_NEVER = _Item(-1, 'never')
_ABSENT = _Item(-1, 'absent')


class Match(NamedTuple):
    """Items of one instant."""

    stamp_ns: int  # of the reference stream's item
    values: tuple[Any, ...]  # in the order of the streams; None where an optional one had nothing


@dataclass
class StreamCounts:
    """What became of a stream's items."""

    matched: int = 0
    unmatched: int = 0  # nothing fitting came on another stream
    overflowed: int = 0  # pushed out of a full queue
    late: int = 0  # older than what the stream gave before


class StampMatcher:
    """Match each item of the first stream with the nearest in time of every other.

    An item is decided on as soon as no nearer one can come, given the spacing of the stream's
    stamps; so nothing waits for the next image when this one fits. Decisions depend on stamps and
    order of arrival only.

    Args:
        names: the streams; the first is the reference, each item of which gives at most one match.
        slop_ns: largest difference of stamps within a match.
        capacity: items kept waiting per stream; the oldest is dropped and counted.
        optional: streams that need not take part: their place in the match is None once a later
            item of theirs shows that there is none, or once the reference is `patience_ns`
            further.
    """

    def __init__(
        self,
        names: Sequence[str],
        slop_ns: int,
        capacity: int = 10,
        optional: Sequence[str] = (),
        patience_ns: int = 0,
    ) -> None:
        self.counts = {name: StreamCounts() for name in names}
        self._names = tuple(names)
        self._slop_ns = slop_ns
        self._capacity = capacity
        self._optional = frozenset(optional)
        self._patience_ns = patience_ns
        self._queues: dict[str, deque[_Item]] = {}
        self._newest_ns: dict[str, int] = {}
        self._period_ns: dict[str, int] = {}
        self.reset()

    def reset(self) -> None:
        """Forget what waits and what was seen of the streams' spacing; counts stay."""
        self._queues = {name: deque() for name in self._names}
        self._newest_ns = {}
        self._period_ns = {}

    def add(self, name: str, stamp_ns: int, value: Any) -> list[Match]:
        """Take an item in and return the matches that it completes, oldest first."""
        newest_ns = self._newest_ns.get(name)
        if newest_ns is not None and stamp_ns <= newest_ns:
            if newest_ns - stamp_ns < RESTART_NS:
                self.counts[name].late += 1
                return []
            self.reset()
            newest_ns = None
        if newest_ns is not None:
            period_ns = stamp_ns - newest_ns
            self._period_ns[name] = min(self._period_ns.get(name, period_ns), period_ns)
        self._newest_ns[name] = stamp_ns
        queue = self._queues[name]
        queue.append(_Item(stamp_ns, value))
        if len(queue) > self._capacity:
            queue.popleft()
            self.counts[name].overflowed += 1
        return self._take_matches()

    def _take_matches(self) -> list[Match]:
        reference = self._queues[self._names[0]]
        matches = []
        while reference:
            stamp_ns = reference[0].stamp_ns
            partners = [self._partner(name, stamp_ns) for name in self._names[1:]]
            if any(partner is _WAIT for partner in partners):
                break
            item = reference.popleft()
            if any(partner is _NEVER for partner in partners):
                self.counts[self._names[0]].unmatched += 1
                continue
            self.counts[self._names[0]].matched += 1
            values = [self._take(n, p) for n, p in zip(self._names[1:], partners, strict=True)]
            matches.append(Match(stamp_ns, (item.value, *values)))
        return matches

    def _partner(self, name: str, stamp_ns: int) -> _Item:
        """Return the item to match, or _WAIT, _NEVER, or _ABSENT for an optional stream."""
        near = min(
            self._queues[name], key=lambda item: abs(item.stamp_ns - stamp_ns), default=None
        )
        if near is not None and abs(near.stamp_ns - stamp_ns) <= self._slop_ns:
            return near if self._is_nearest(name, near, stamp_ns) else _WAIT
        if self._newest_ns.get(name, stamp_ns) > stamp_ns:
            return _ABSENT if name in self._optional else _NEVER
        if name in self._optional:
            waited_ns = self._newest_ns[self._names[0]] - stamp_ns
            return _ABSENT if waited_ns > self._patience_ns else _WAIT
        return _WAIT

    def _is_nearest(self, name: str, near: _Item, stamp_ns: int) -> bool:
        if self._newest_ns[name] >= stamp_ns:
            return True
        if self._newest_ns[self._names[0]] - stamp_ns > self._slop_ns:
            return True  # the stream has fallen silent or behind; this one fits
        next_ns = near.stamp_ns + self._period_ns.get(name, 0)
        return next_ns - stamp_ns >= stamp_ns - near.stamp_ns

    def _take(self, name: str, partner: _Item) -> Any:
        """Remove the partner from its queue, and what is older, as that can match nothing more."""
        if partner is _ABSENT:
            return None
        queue = self._queues[name]
        while queue[0] is not partner:
            queue.popleft()
            self.counts[name].unmatched += 1
        queue.popleft()
        self.counts[name].matched += 1
        return partner.value
