"""Schedule of a playback, without ROS: messages with due times, and the clock it follows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_topics import topics_to_play
from hoid_bags.bag.contents import BagTopic
from hoid_bags.bag.stamps import begins_with_header, shift_header_stamp
from hoid_common.config import Config, param
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S

LOOP_GAP_NS = 100_000_000
"""Time from the last message of a round to the first of the next. Chosen: 3 images at 30 Hz."""


@dataclass(frozen=True)
class PlayConfig(Config):
    """Options of a playback."""

    rate: float = param(1.0, 'speed as a multiple of real time', limits=(1e-3, 1e3))
    loop: bool = param(False, 'restart at the end, with increasing stamps')
    start_s: float = param(0.0, 'time to skip at the start', limits=(0.0, inf))
    duration_s: float = param(0.0, 'time to play; 0: to the end', limits=(0.0, inf))
    lockstep: bool = param(False, 'publish each image after the odometry of the one before')
    no_clock: bool = param(False, 'do not publish /clock')
    wait_s: float = param(5.0, 'longest time to wait for subscribers', limits=(0.0, inf))
    lockstep_timeout_s: float = param(10.0, limits=(0.0, inf), internal=True)


class ScheduledMessage(NamedTuple):
    """A message and the time at which it is due."""

    topic: str  # name in the bag
    time_ns: int  # time on the clock of the playback
    offset_ns: int  # time that is added to all stamps of the bag in this repetition
    data: bytes  # serialized message (CDR)


@dataclass(frozen=True)
class PlaybackPlan:
    """The part of a bag that is played."""

    path: Path
    topics: tuple[BagTopic, ...]
    start_ns: int  # log time from which messages are played
    end_ns: int  # log time up to which, inclusive, messages are played
    fault: str | None  # damage that is known before the bag is played; None: no damage

    @property
    def period_ns(self) -> int:
        return self.end_ns - self.start_ns + LOOP_GAP_NS

    def messages(self, *, loop: bool) -> Iterator[ScheduledMessage]:
        """Yield the messages in order of time; with `loop`, the bag is repeated without end.

        In each repetition, an offset is added to the log times, and to the stamp of each message
        whose type begins with a header. Stamps inside other messages, such as /tf, stay.

        Raises:
            InputError: After the last message, if the bag has damage that `fault` does not name.
            MessageError: In a repetition, a message is too short for the header of its type.
        """
        with_header = {t.name for t in self.topics if begins_with_header(t.type_name)}
        yield from self._round(0, set())
        offset_ns = self.period_ns
        while loop:
            yield from self._round(offset_ns, with_header)
            offset_ns += self.period_ns

    def _round(self, offset_ns: int, with_header: set[str]) -> Iterator[ScheduledMessage]:
        wanted = [topic.name for topic in self.topics]
        with BagReader(self.path) as reader:
            for topic, log_ns, data in reader.messages(wanted, self.start_ns):
                if log_ns > self.end_ns:
                    return
                shifted = shift_header_stamp(data, offset_ns) if topic in with_header else data
                yield ScheduledMessage(topic, log_ns + offset_ns, offset_ns, shifted)
            if reader.fault is not None and reader.fault != self.fault:
                raise InputError(reader.fault)


def open_plan(path: Path, config: PlayConfig, topics: tuple[str, ...] = ()) -> PlaybackPlan:
    """Return the playback plan of a bag; without topic names, all topics but /clock are played.

    InputError if the path is no readable bag, the bag lacks a topic or has no messages to play, or
    the last message to play is before the chosen start.
    """
    with BagReader(path) as reader:
        chosen = topics_to_play(reader, topics)
        spans = [reader.topic_span_ns(topic.name) for topic in chosen]
        fault = reader.fault
    start_ns = min(first for first, _ in spans) + round(config.start_s * NS_PER_S)
    end_ns = max(last for _, last in spans)
    if start_ns > end_ns:
        raise InputError(
            f'{path}: --start {config.start_s:g} s lies after its end; give a smaller one'
        )
    if config.duration_s:
        end_ns = min(end_ns, start_ns + round(config.duration_s * NS_PER_S))
    return PlaybackPlan(path, chosen, start_ns, end_ns, fault)


class Pacer:
    """Clock of the playback, which shows the time of the bag and can be paused."""

    def __init__(
        self, start_ns: int, rate: float, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._start_ns, self._rate, self._now_s = start_ns, rate, now_s
        self._start_s = now_s()
        self._held_s: float | None = None

    def time_ns(self) -> int:
        at_s = self._now_s() if self._held_s is None else self._held_s
        return self._start_ns + round((at_s - self._start_s) * self._rate * NS_PER_S)

    def remaining_s(self, time_ns: int) -> float:
        """Return the real time in s until a time of the bag in ns; negative when it has passed."""
        return (time_ns - self.time_ns()) / NS_PER_S / self._rate

    def hold(self) -> None:
        if self._held_s is None:
            self._held_s = self._now_s()

    def release(self) -> None:
        if self._held_s is not None:
            self._start_s += self._now_s() - self._held_s
            self._held_s = None
