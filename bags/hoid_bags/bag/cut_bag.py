"""What is left of MCAP bags whose recording was cut off."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from hoid_bags.bag.bag_source import BagMessage, BagTopic

_CUT = (McapError, ZstdError, struct.error, ValueError, OSError)


class CutBag:
    """MCAP files without index: read from their start as far as that goes.

    The order is that of the files; recorders fill them in order of time.
    """

    def __init__(self, files: list[Path]) -> None:
        """Read the files once, to know what is there."""
        self._files = files
        self.whole_files = 0
        self._types: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self._spans_ns: dict[str, tuple[int, int]] = {}
        for message in self._read():
            log_ns = message.log_ns
            first_ns, last_ns = self._spans_ns.get(message.topic, (log_ns, log_ns))
            self._spans_ns[message.topic] = min(first_ns, log_ns), max(last_ns, log_ns)
            self._counts[message.topic] += 1

    @property
    def is_whole(self) -> bool:
        """Return whether every file has its end, so that only metadata.yaml is wrong."""
        return self.whole_files == len(self._files)

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """Return every topic that was announced before the cut."""
        return tuple(
            BagTopic(name, type_name, self._counts[name], None)
            for name, type_name in self._types.items()
        )

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the first and the last message."""
        spans = self._spans_ns.values()
        return min((s[0] for s in spans), default=0), max((s[1] for s in spans), default=0)

    def topic_span_ns(self, topic: str) -> tuple[int, int]:
        """Return the log times of a topic's first and last message."""
        return self._spans_ns.get(topic, (0, 0))

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield messages as they stand in the files."""
        for message in self._read():
            wanted = topics is None or message.topic in topics
            if wanted and (start_ns is None or message.log_ns >= start_ns):
                yield message

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""

    def _read(self) -> Iterator[BagMessage]:
        self.whole_files = 0
        for path in self._files:
            try:
                yield from self._read_file(path)
            except _CUT:
                continue  # `whole_files` tells that this one ended early

    def _read_file(self, path: Path) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        with path.open('rb') as file:
            for record in StreamReader(file).records:
                match record:
                    case Schema():
                        schemas[record.id] = record
                    case Channel(message_encoding='cdr') if record.schema_id in schemas:
                        channels[record.id] = record
                        self._types[record.topic] = schemas[record.schema_id].name
                    case Message() if record.channel_id in channels:
                        topic = channels[record.channel_id].topic
                        yield BagMessage(topic, record.log_time, record.data)
                    case Footer():
                        self.whole_files += 1
