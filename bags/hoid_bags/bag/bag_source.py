"""What a bag gives to its readers, and the whole bag that gives it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos

from hoid_bags.mcap.chunk_reader import TolerantReader
from hoid_bags.mcap.chunks import Damage

_FIRST_WINDOW_NS = 1_000_000_000


class BagTopic(NamedTuple):
    """One topic of a bag."""

    name: str  # absolute
    type_name: str
    num_messages: int
    qos: Qos | None  # as offered when it was recorded


class BagMessage(NamedTuple):
    """One message, still serialised."""

    topic: str
    log_ns: int  # when it was recorded
    data: bytes  # CDR


class BagSource(Protocol):
    """What gives topics and messages: a whole bag, or what is left of one."""

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """Return every topic that was announced."""

    @property
    def damage(self) -> Sequence[Damage]:
        """Return what was left out of what has been read so far."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the first and the last message; (0, 0) without messages."""

    def topic_span_ns(self, topic: str) -> tuple[int, int]:
        """Return the same of one topic."""

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield messages in order of time: of these topics, at or after `start_ns`."""

    def close(self) -> None:
        """Close the files."""


class WholeBag:
    """A bag with index and metadata."""

    def __init__(self, path: Path) -> None:
        self._reader = TolerantReader(path)
        self._reader.open()

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """Return every topic; one that was recorded with several QoS counts once."""
        merged: dict[str, BagTopic] = {}
        for connection in self._reader.connections:
            profiles = (
                connection.ext.offered_qos_profiles
                if isinstance(connection.ext, ConnectionExtRosbag2)
                else []
            )
            before = merged.get(connection.topic)
            merged[connection.topic] = BagTopic(
                connection.topic,
                connection.msgtype,
                connection.msgcount + (before.num_messages if before else 0),
                profiles[0] if profiles else None,
            )
        return tuple(merged.values())

    @property
    def damage(self) -> Sequence[Damage]:
        """Return the damaged chunks that were met so far."""
        return self._reader.damage

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the first and the last message."""
        if not self._reader.message_count:
            return 0, 0
        return self._reader.start_time, self._reader.end_time - 1

    def topic_span_ns(self, topic: str) -> tuple[int, int]:
        """Return the log times of a topic's first and last message; the index finds both."""
        connections = self._connections([topic])
        first_ns = next((log_ns for _, log_ns, _ in self._reader.messages(connections)), 0)
        _, end_ns = self.span_ns  # as the metadata say, which may be wrong
        window_ns = _FIRST_WINDOW_NS
        while first_ns:
            tail = self._reader.messages(connections, start=max(end_ns - window_ns, first_ns))
            last_ns = max((log_ns for _, log_ns, _ in tail), default=None)
            if last_ns is not None:
                return first_ns, last_ns
            window_ns *= 4
        return 0, 0

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield messages in order of time."""
        connections = self._connections(topics)
        if connections:
            for connection, log_ns, data in self._reader.messages(connections, start=start_ns):
                yield BagMessage(connection.topic, log_ns, data)

    def _connections(self, topics: Collection[str] | None) -> list[Connection]:
        return [c for c in self._reader.connections if topics is None or c.topic in topics]
