"""Synchronization of streams by stamps: a match is complete when no better one is expected."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S, IntArray

# If a stamp is older than its predecessor by at least this much, time has started anew, as when a
# bag is played in a loop or a clock is set. Chosen far above any reordering of messages in flight.
RESTART_NS = 1_000_000_000
# Chosen: tolerance of a period, because stamps vary by a few milliseconds around the frame rate.
_EARLY_NS = 5_000_000
# Chosen: a color image equal to an earlier one counts as repeated by the driver if the earlier one
# is at most this old. Otherwise the camera is at rest: simulators then render equal images.
MAX_COPY_AGE_NS = 250_000_000
# Chosen: a larger offset between two streams is no delay within a driver; the streams have
# different clocks.
_LONGEST_OFFSET_NS = 500_000_000
_NUM_GAPS = 15  # chosen: half a second of images without any match reveals an offset
_NUM_STAMPS = 90  # chosen: a constant offset is estimated from the images of 3 s at 30 Hz
_MIN_IMAGES = 30  # chosen: fewer images do not suffice to estimate a period
_MAX_SPREAD_NS = 1_000_000  # chosen: an offset that varies more is not constant
# Chosen: if the offset is less than this ratio of the period of depth images, the nearest image is
# certainly the right one.
_MIN_SHARE = 0.2
# Chosen: another image is preferred to the nearest one only if its distance varies less by this
# much.
_MARGIN_NS = 200_000

OFFSET_REMEDY = '--depth-offset {0:.4f} (input.depth_offset_s of live nodes)'
"""Text for errors: the option and the parameter that correct a constant offset, given in s."""


class _Item(NamedTuple):
    stamp_ns: int
    value: Any


# `_partner` returns one of these instead of an item:
_WAIT = _Item(-1, 'wait')  # a better partner may still arrive
_NEVER = _Item(-1, 'never')  # no partner can arrive any more, so the reference item is dropped
_ABSENT = _Item(-1, 'absent')  # no partner can arrive any more, but the stream is optional


def offset_text(gap_ns: float, slop_ns: float, first: str = 'color', second: str = 'depth') -> str:
    """Return a line about the median gap between two streams that do not match, with a remedy."""
    if abs(gap_ns) > _LONGEST_OFFSET_NS:
        return (
            f'the stamps of {second} are {gap_ns * 1e-9:+.3f} s from those of {first}, so two '
            'clocks were used or one stamp is not set: let the driver use one clock for both'
        )
    return (
        f'the stamps of {second} are {gap_ns * 1e-6:+.1f} ms from those of {first} '
        f'(limit {slop_ns * 1e-6:g}): raise sync_slop_s to {abs(gap_ns) * 1.2e-9:.3f}, or set '
        f'{OFFSET_REMEDY.format(gap_ns * 1e-9)}, if they belong together'
    )


def constant_offset_text(color_ns: IntArray, depth_ns: IntArray) -> str:
    """Return a warning if a constant offset probably pairs the wrong images, else ''.

    If a driver at 30 Hz stamps depth 25 ms late, the nearest depth image, 8 ms away, belongs to
    the previous color image. The right one is that whose distance varies least, because the period
    varies more than the offset. Stamps (A,) and (B,) increase.
    """
    if min(len(color_ns), len(depth_ns)) < _MIN_IMAGES:
        return ''
    after = np.searchsorted(depth_ns, color_ns)
    has_both = (after >= 2) & (after < len(depth_ns) - 1)
    if has_both.sum() < _MIN_IMAGES // 2:
        return ''
    # Distances to the two images before and the two after each color image.
    near = after[has_both, None] + np.arange(-2, 2)
    gaps_ns = depth_ns[near] - color_ns[has_both, None]
    nearest = int(np.abs(np.median(gaps_ns, axis=0)).argmin())
    low_ns, high_ns = np.percentile(gaps_ns, (5, 95), axis=0)
    spread_ns = high_ns - low_ns
    spread_ns[nearest] -= _MARGIN_NS
    best = int(spread_ns.argmin())
    offset_ns, period_ns = float(np.median(gaps_ns[:, best])), float(np.median(np.diff(depth_ns)))
    if spread_ns[best] > _MAX_SPREAD_NS or abs(offset_ns) < _MIN_SHARE * period_ns:
        return ''
    other_ns = offset_ns - np.copysign(period_ns, offset_ns)
    return (
        f'the stamps of depth are always {offset_ns * 1e-6:+.1f} ms from those of color, or '
        f'{other_ns * 1e-6:+.1f} ms from those of the neighboring image: if they were taken at '
        f'the same instant, set {OFFSET_REMEDY.format(offset_ns * 1e-9)}'
    )


class Match(NamedTuple):
    """Items of all streams that belong to one instant."""

    stamp_ns: int  # stamp of the reference stream's item
    # In the order of the streams; None for an optional stream without an item.
    values: tuple[Any, ...]


@dataclass
class StreamCounts:
    """Counts of a stream's items: matched, or dropped for one of three reasons."""

    matched: int = 0
    unmatched: int = 0  # items dropped without a match
    overflowed: int = 0  # items dropped from a full queue
    late: int = 0  # dropped because they are not newer than the stream's previous item


class StampMatcher:
    """Matches each item of the reference stream with the nearest in time of every other stream.

    A match removes its items and all older ones from the streams. Therefore the reference should
    not be faster than a stream that is not optional.

    A match is complete when every stream has an item within `slop_ns` of the reference item, and
    none can get a nearer one: the stream has an item that is not older, its next item after its
    shortest period would not be nearer, or the reference has advanced by more than `slop_ns`. A
    reference item is dropped if a stream that is not optional has no item within `slop_ns`, but a
    later one.

    A match waits for an optional stream until that has a later item, or the reference has advanced
    by more than `patience_ns`; its value is then None. At most `capacity` items wait per stream.
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
        self._gaps_ns: deque[int] = deque(maxlen=_NUM_GAPS)  # gaps of unmatched reference items
        # Of the latest items of the first two streams, for `constant_offset_text`.
        self._stamps_ns: dict[str, deque[int]] = {}
        self._constant_offset = ''  # text of `constant_offset_text`
        self.reset()

    @property
    def mismatch(self) -> str:
        """Return a text about streams that do not match or have a constant offset, else ''."""
        return self.gap or self._constant_offset

    @property
    def gap(self) -> str:
        """Return `offset_text` if each of the last 15 reference items had no match, else ''."""
        if len(self._gaps_ns) < _NUM_GAPS:
            return ''
        return offset_text(median(self._gaps_ns), self._slop_ns, *self._names[:2])

    def reset(self) -> None:
        """Drop waiting items and all estimates (periods, gaps, offset), but not the counts."""
        self._queues = {name: deque() for name in self._names}
        self._newest_ns = {}
        self._period_ns = {}
        self._gaps_ns.clear()
        self._stamps_ns = {name: deque(maxlen=_NUM_STAMPS) for name in self._names[:2]}
        self._constant_offset = ''

    def add(self, name: str, stamp_ns: int, value: Any) -> list[Match]:
        """Add an item to a stream and return the matches that it completes, oldest first.

        An item that is a second older than the newest item of its stream resets all streams. Any
        other item that is not newer is dropped.
        """
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
        self._note_stamp(name, stamp_ns)
        queue = self._queues[name]
        queue.append(_Item(stamp_ns, value))
        if len(queue) > self._capacity:
            oldest = queue.popleft()
            self.counts[name].overflowed += 1
            if name == self._names[0]:
                self._note_gap(oldest.stamp_ns)
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
                self._note_gap(stamp_ns)
                continue
            self.counts[self._names[0]].matched += 1
            self._gaps_ns.clear()
            values = [self._take(n, p) for n, p in zip(self._names[1:], partners, strict=True)]
            matches.append(Match(stamp_ns, (item.value, *values)))
        return matches

    def _note_stamp(self, name: str, stamp_ns: int) -> None:
        """Store a stamp; after every 90 stamps of both streams, look for a constant offset."""
        if name not in self._stamps_ns:
            return
        self._stamps_ns[name].append(stamp_ns)
        if all(len(stamps) == _NUM_STAMPS for stamps in self._stamps_ns.values()):
            first, second = (np.array(stamps, np.int64) for stamps in self._stamps_ns.values())
            self._constant_offset = constant_offset_text(first, second)
            for stamps in self._stamps_ns.values():
                stamps.clear()

    def _note_gap(self, stamp_ns: int) -> None:
        other = self._names[1]
        if other in self._newest_ns:
            stamps_ns = [item.stamp_ns for item in self._queues[other]] + [self._newest_ns[other]]
            self._gaps_ns.append(min((s - stamp_ns for s in stamps_ns), key=abs))

    def _partner(self, name: str, stamp_ns: int) -> _Item:
        """Return the stream's partner for the reference stamp, or _WAIT, _NEVER or _ABSENT."""
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
            return True  # the stream is silent or delayed: do not wait for a nearer item
        next_ns = near.stamp_ns + self._period_ns.get(name, 0)
        return next_ns - stamp_ns >= stamp_ns - near.stamp_ns

    def _take(self, name: str, partner: _Item) -> Any:
        """Remove a partner and all older items, which can no longer match; return its value."""
        if partner is _ABSENT:
            return None
        queue = self._queues[name]
        while queue[0] is not partner:
            queue.popleft()
            self.counts[name].unmatched += 1
        queue.popleft()
        self.counts[name].matched += 1
        return partner.value


class Rate:
    """Selects stamps at an average rate, which need not divide the frame rate; 0 selects all."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NS_PER_S / rate_hz) if rate_hz else 0
        self._last_ns: int | None = None

    def take_due(self, stamp_ns: int) -> bool:
        """Return whether the image with this stamp is selected.

        The next image is due about a period after a selected one, so that the average rate is
        kept. Calls must be in order of time. An image whose stamp is a second earlier than the
        last selected one is selected, because the recording has started again.
        """
        if not self.is_due(stamp_ns):
            return False
        grid_ns = stamp_ns if self._last_ns is None else self._last_ns + self._period_ns
        on_time = 0 <= stamp_ns - grid_ns < self._period_ns
        self._last_ns = grid_ns if on_time else stamp_ns
        return True

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether `take_due` would select the image with this stamp."""
        last_ns = self._last_ns
        if not self._period_ns or last_ns is None or stamp_ns < last_ns - RESTART_NS:
            return True
        return stamp_ns >= last_ns + self._period_ns - _EARLY_NS
