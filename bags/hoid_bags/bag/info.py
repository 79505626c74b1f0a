"""Summary of a bag: topics, numbers, rates and sizes of messages."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import QosDurability

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.contents import BagTopic
from hoid_common.io.stamps import format_stamp_s
from hoid_common.values import NS_PER_S

_MB = 1e6


class TopicSummary(NamedTuple):
    """Summary of one topic."""

    name: str
    type_name: str
    num_messages: int
    # Mean rate between its first and last message, or over the whole bag if it is latched.
    # 0 with fewer than two messages, or if all have the same log time.
    rate_hz: float
    size_bytes: int | None = None  # total size of its serialized messages; None: not counted

    @property
    def bytes_per_s(self) -> float | None:
        """Return mean size times rate; None if there are no messages or sizes."""
        if self.size_bytes is None or not self.num_messages:
            return None
        return self.size_bytes / self.num_messages * self.rate_hz


class BagSummary(NamedTuple):
    """Summary of a bag."""

    path: Path
    size_bytes: int  # size of all files
    start_ns: int  # log time of the first message
    end_ns: int  # log time of the last message
    topics: tuple[TopicSummary, ...]
    fault: str | None  # line of text about damage; None: no damage was found

    @property
    def num_messages(self) -> int:
        return sum(topic.num_messages for topic in self.topics)

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / NS_PER_S


def summarize(path: Path, *, sizes: bool = False) -> BagSummary:
    """Return the summary of a bag; `sizes` reads all messages to count the bytes of each topic."""
    with BagReader(path) as reader:
        counted: Counter[str] = Counter()
        for topic, _, data in reader.messages() if sizes else ():
            counted[topic] += len(data)
        summaries = tuple(
            TopicSummary(
                t.name, t.type_name, t.num_messages, _rate_hz(reader, t),
                counted[t.name] if sizes else None,
            )
            for t in sorted(reader.topics)
        )  # fmt: skip
        files = list(path.iterdir()) if path.is_dir() else [path]
        size_bytes = sum(file.stat().st_size for file in files if file.is_file())
        return BagSummary(path, size_bytes, *reader.span_ns, summaries, reader.fault)


def describe(summary: BagSummary) -> str:
    """Return a summary as text: a few lines about the bag, then a table of its topics."""
    when = datetime.fromtimestamp(summary.start_ns // NS_PER_S, UTC)
    lines = [
        f'bag       {summary.path} ({summary.size_bytes / _MB:.1f} MB)',
        f'start     {format_stamp_s(summary.start_ns)} ({when:%Y-%m-%d %H:%M:%S} UTC)',
        f'duration  {summary.duration_s:.3f} s',
        f'messages  {summary.num_messages}',
    ]
    rows: list[tuple[str, ...]] = [('topic', 'type', 'messages', 'rate', 'bandwidth')]
    for t in summary.topics:
        rate = f'{t.rate_hz:.2f} Hz' if t.rate_hz else '-'
        bandwidth = '-' if t.bytes_per_s is None else f'{t.bytes_per_s / _MB:.3f} MB/s'
        rows.append((t.name, t.type_name, str(t.num_messages), rate, bandwidth))
    if all(t.size_bytes is None for t in summary.topics):
        rows = [row[:-1] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, kind, *numbers in rows:
        right = '  '.join(f'{n:>{w}}' for n, w in zip(numbers, widths[2:], strict=True))
        lines.append(f'{name:<{widths[0]}}  {kind:<{widths[1]}}  {right}')
    return '\n'.join(lines)


def _rate_hz(reader: BagReader, topic: BagTopic) -> float:
    # A recorder receives all old messages of a latched topic at once, when it subscribes.
    is_latched = topic.qos is not None and topic.qos.durability == QosDurability.TRANSIENT_LOCAL
    first_ns, last_ns = reader.span_ns if is_latched else reader.topic_span_ns(topic.name)
    if topic.num_messages < 2 or last_ns <= first_ns:
        return 0.0
    return (topic.num_messages - 1) * NS_PER_S / (last_ns - first_ns)
