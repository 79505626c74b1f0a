"""What is in a bag, in a few lines."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag_reader import BagReader
from hoid_bags.stamps import NS_PER_S, format_stamp_s

_MB = 1e6


class TopicSummary(NamedTuple):
    """One topic in numbers."""

    name: str
    type_name: str
    num_messages: int
    rate_hz: float  # 0 with fewer than two messages


class BagSummary(NamedTuple):
    """A bag in numbers."""

    path: Path
    size_bytes: int
    start_ns: int  # log time of the first message
    end_ns: int  # of the last
    topics: tuple[TopicSummary, ...]
    fault: str | None

    @property
    def num_messages(self) -> int:
        """Return the number of messages on all topics."""
        return sum(topic.num_messages for topic in self.topics)

    @property
    def duration_s(self) -> float:
        """Return the time from the first to the last message."""
        return (self.end_ns - self.start_ns) / NS_PER_S


def summarize(path: Path) -> BagSummary:
    """Return a bag's summary.

    Raises:
        InputError: no bag, or nothing of it can be read.
    """
    with BagReader(path) as reader:
        topics = tuple(
            TopicSummary(
                t.name, t.type_name, t.num_messages, _rate_hz(reader, t.name, t.num_messages)
            )
            for t in sorted(reader.topics)
        )
        start_ns, end_ns = reader.span_ns
        files = list(path.iterdir()) if path.is_dir() else [path]
        size = sum(file.stat().st_size for file in files)
        return BagSummary(path, size, start_ns, end_ns, topics, reader.fault)


def describe(summary: BagSummary) -> str:
    """Return a summary as text."""
    when = datetime.fromtimestamp(summary.start_ns // NS_PER_S, UTC)
    lines = [
        f'bag       {summary.path} ({summary.size_bytes / _MB:.1f} MB)',
        f'start     {format_stamp_s(summary.start_ns)} ({when:%Y-%m-%d %H:%M:%S} UTC)',
        f'duration  {summary.duration_s:.3f} s',
        f'messages  {summary.num_messages}',
    ]
    rows = [('topic', 'type', 'messages', 'rate')]
    rows += [
        (t.name, t.type_name, str(t.num_messages), f'{t.rate_hz:.2f} Hz') for t in summary.topics
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines += [
        f'{name:<{widths[0]}}  {kind:<{widths[1]}}  {count:>{widths[2]}}  {rate:>{widths[3]}}'
        for name, kind, count, rate in rows
    ]
    return '\n'.join(lines)


def _rate_hz(reader: BagReader, topic: str, num_messages: int) -> float:
    first_ns, last_ns = reader.topic_span_ns(topic)
    if num_messages < 2 or last_ns <= first_ns:
        return 0.0
    return (num_messages - 1) * NS_PER_S / (last_ns - first_ns)
