"""What is left of MCAP bags whose recording was cut off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Qos
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import parse_qos

from hoid_bags.bag.bag_source import BagMessage, BagTopic
from hoid_bags.mcap.chunks import (
    DAMAGE,
    MAX_CHUNK_BYTES,
    NO_RECORD,
    Damage,
    messages,
    one_line,
    unpack,
    walk,
)
from hoid_common.io.untrusted import open_regular

_SCHEMA, _CHANNEL = 0x03, 0x04


class CutBag:
    """MCAP files without index: read from their start as far as that goes.

    The order is that of the files; recorders fill them in order of time.
    """

    def __init__(self, files: list[Path]) -> None:
        """Read the files once, to know what is there."""
        self._files = files
        self.whole_files = 0
        self.damage: list[Damage] = []
        self._types: dict[str, tuple[str, Qos | None]] = {}
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
            BagTopic(name, type_name, self._counts[name], qos)
            for name, (type_name, qos) in self._types.items()
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
        self.damage = []
        for path in self._files:
            file = _CutFile(path)
            yield from file.messages()
            self.whole_files += file.is_whole
            self.damage += file.damage
            self._types |= file.types


class _Records(StreamReader):
    """Records of a file, up to where there are none; `StreamReader` would count zeros."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode == NO_RECORD:
            raise ReaderError('zeros where a record should be')
        return super()._read_record(opcode, length)


class _CutFile:
    """One pass over one file."""

    def __init__(self, path: Path) -> None:
        self.is_whole = False
        self.damage: list[Damage] = []
        self.types: dict[str, tuple[str, Qos | None]] = {}
        self._path = path
        self._is_damaged = False  # the latest chunk
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}  # of channels in CDR

    def messages(self) -> Iterator[BagMessage]:
        """Yield what can be read, up to where the file itself makes no sense any more."""
        with open_regular(self._path) as file:
            reader = _Records(file, emit_chunks=True, record_size_limit=MAX_CHUNK_BYTES)
            try:
                for record in reader.records:
                    yield from self._of_record(record, file)
            except DAMAGE:
                return  # `is_whole` tells that it ended early

    def _of_record(self, record: McapRecord, file: BinaryIO) -> Iterator[BagMessage]:
        match record:
            case Chunk():
                yield from self._of_chunk(record, file.tell())
            case MessageIndex() if self._is_damaged:
                self._count_lost(record)
            case Schema() | Channel():
                self._note(record)
            case Message() if record.channel_id in self._topics:
                yield BagMessage(self._topics[record.channel_id], record.log_time, record.data)
            case Footer():
                self.is_whole = True

    def _of_chunk(self, chunk: Chunk, end: int) -> Iterator[BagMessage]:
        """Yield all messages of a chunk, or none of one that is damaged."""
        self._is_damaged = False
        try:
            records = unpack(
                chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc
            )
            for opcode, start, stop in walk(records):
                if opcode in (_SCHEMA, _CHANNEL):
                    kind = Schema if opcode == _SCHEMA else Channel
                    self._note(kind.read(ReadDataStream(BytesIO(records[start:stop]))))
            found = list(messages(records))
        except DAMAGE as error:
            self._is_damaged = True
            offset = end - len(chunk.data)
            self.damage.append(Damage(self._path, offset, one_line(error), {}))
            return
        for channel_id, log_ns, data in found:
            if channel_id in self._topics:
                yield BagMessage(self._topics[channel_id], log_ns, data)

    def _count_lost(self, index: MessageIndex) -> None:
        last = self.damage[-1]
        topic = self._topics.get(index.channel_id, 'unknown topics')
        lost = Counter(last.lost) + Counter({topic: len(index.records)})
        self.damage[-1] = last._replace(lost=lost)

    def _note(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
        elif record.message_encoding == 'cdr' and record.schema_id in self._schemas:
            self._topics[record.id] = record.topic
            qos = parse_qos(record.metadata.get('offered_qos_profiles', ''))
            self.types[record.topic] = self._schemas[record.schema_id], qos[0] if qos else None
