"""What to play and when, without ROS: messages as cues on a clock that only advances."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag import bag_types
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_sequence import header_stamp_ns
from hoid_bags.bag.bag_source import BagTopic
from hoid_common import topics as names
from hoid_common.config import Config, param
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S

LOOP_GAP_NS = 100_000_000
"""Between the last message of one round and the first of the next: about three images."""

_HEADER = ('header', 'std_msgs/msg/Header')


@dataclass(frozen=True)
class PlayConfig(Config):
    """How a bag is played."""

    rate: float = param(1.0, 'Times real time', minimum=1e-3, maximum=1e3)
    loop: bool = param(False, 'Begin again at the end; stamps go on, so that time never goes back')
    start_s: float = param(0.0, 'Where to begin, from the first message played', minimum=0.0)
    duration_s: float = param(0.0, 'How much of the bag to play; 0 = all', minimum=0.0)
    clock: bool = param(True, 'Publish the time of the bag on /clock')
    lockstep: bool = param(False, "Wait with each frame for the previous one's odometry")
    lockstep_timeout_s: float = param(10.0, 'Then go on without', minimum=0.0)
    wait_s: float = param(5.0, 'How long to wait for subscribers at the start', minimum=0.0)


class ScheduledMessage(NamedTuple):
    """A message to publish at a moment."""

    topic: str  # as in the bag
    time_ns: int  # on the playback's clock
    offset_ns: int  # by which this round's times and stamps lie after the bag's
    data: bytes  # CDR


@dataclass(frozen=True)
class PlaybackPlan:
    """The part of a bag that is played."""

    path: Path
    topics: tuple[BagTopic, ...]
    start_ns: int
    end_ns: int  # inclusive
    fault: str | None  # of the bag

    @property
    def period_ns(self) -> int:
        """Return by how much a round comes after the one before."""
        return self.end_ns - self.start_ns + LOOP_GAP_NS

    def cues(self, *, loop: bool) -> Iterator[ScheduledMessage]:
        """Yield the cues in order of time, without end when looping.

        In later rounds the stamp of every message that begins with a header is moved as well.

        Raises:
            InputError: after the last readable cue, when the bag turns out to be damaged.
        """
        with_header = {t.name for t in self.topics if _has_header(t.type_name)}
        offset_ns = 0
        while True:
            for cue in self._round(offset_ns):
                moved = offset_ns and cue.topic in with_header
                yield cue._replace(data=moved_header(cue.data, offset_ns)) if moved else cue
            if not loop:
                return
            offset_ns += self.period_ns

    def _round(self, offset_ns: int) -> Iterator[ScheduledMessage]:
        wanted = [topic.name for topic in self.topics]
        with BagReader(self.path) as reader:
            for topic, log_ns, data in reader.messages(wanted, self.start_ns):
                if log_ns > self.end_ns:
                    return
                yield ScheduledMessage(topic, log_ns + offset_ns, offset_ns, data)
            if reader.fault is not None and reader.fault != self.fault:
                raise InputError(reader.fault)


def open_plan(path: Path, config: PlayConfig, topics: tuple[str, ...] = ()) -> PlaybackPlan:
    """Return what to play of a bag.

    Args:
        path: The bag.
        config: How to play it.
        topics: Names to play, with or without leading slash; empty means all but /clock.

    Raises:
        InputError: nothing there to play.
    """
    with BagReader(path) as reader:
        chosen = _choose(reader, topics)
        spans = [reader.topic_span_ns(topic.name) for topic in chosen]
        fault = reader.fault
    start_ns = min(first for first, _ in spans) + round(config.start_s * NS_PER_S)
    end_ns = max(last for _, last in spans)
    if start_ns > end_ns:
        raise InputError(f'{path}: --start {config.start_s:g} s lies after its end')
    if config.duration_s:
        end_ns = min(end_ns, start_ns + round(config.duration_s * NS_PER_S))
    return PlaybackPlan(path, chosen, start_ns, end_ns, fault)


def moved_header(data: bytes, offset_ns: int) -> bytes:
    """Return a serialised message that begins with a header, with its stamp moved."""
    moved = bytearray(data)
    stamp = divmod(header_stamp_ns(data) + offset_ns, NS_PER_S)
    struct.pack_into('<iI' if data[1] else '>iI', moved, 4, *stamp)
    return bytes(moved)


class Pacer:
    """The playback's clock: the bag's time, at a rate, that can be held."""

    def __init__(
        self, start_ns: int, rate: float, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._start_ns, self._rate, self._now_s = start_ns, rate, now_s
        self._start_s = now_s()
        self._held_s: float | None = None

    def time_ns(self) -> int:
        """Return the time of the bag."""
        at_s = self._now_s() if self._held_s is None else self._held_s
        return self._start_ns + round((at_s - self._start_s) * self._rate * NS_PER_S)

    def remaining_s(self, time_ns: int) -> float:
        """Return the real time until a time of the bag; negative when it is past."""
        return (time_ns - self.time_ns()) / NS_PER_S / self._rate

    def hold(self) -> None:
        """Let time stand still."""
        if self._held_s is None:
            self._held_s = self._now_s()

    def release(self) -> None:
        """Let time go on from where it was held."""
        if self._held_s is not None:
            self._start_s += self._now_s() - self._held_s
            self._held_s = None


def _choose(reader: BagReader, wanted: tuple[str, ...]) -> tuple[BagTopic, ...]:
    by_name = {topic.name: topic for topic in reader.topics}
    absolute = [f'/{name.lstrip("/")}' for name in wanted]
    for name in absolute:
        if name not in by_name:
            raise InputError(f'{reader.path}: has no topic "{name}"; see "hoid info"')
    chosen = (
        [by_name[n] for n in absolute]
        if wanted
        else [topic for topic in reader.topics if topic.name != names.CLOCK]
    )
    filled = tuple(topic for topic in chosen if topic.num_messages)
    if not filled:
        raise InputError(f'{reader.path}: holds no messages to play')
    return filled


def _has_header(type_name: str) -> bool:
    try:
        bag_types.ensure_type(type_name)
    except InputError:
        return False
    fields = bag_types.shared_typestore().fielddefs[type_name][1]
    return bool(fields) and (fields[0][0], fields[0][1][1]) == _HEADER
