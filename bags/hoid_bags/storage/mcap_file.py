"""MCAP files, read chunk by chunk: damaged chunks are left out and listed."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader
from rosbags import interfaces
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader

from hoid_bags.storage import chunks
from hoid_bags.storage.chunks import DAMAGE, DamagedChunk, one_line
from hoid_bags.storage.qos_profiles import stored_qos

_RECORD_HEAD_BYTES = 9  # opcode and size
# Chunk header after it: two times, two sizes, checksum, length of the compression's name.
_CHUNK_HEAD_BYTES = 4 * 8 + 2 * 4
_MAX_TIME_NS = 2**63
_NO_DEFINITION = interfaces.MessageDefinition(interfaces.MessageDefinitionFormat.NONE, '')


class _Item(NamedTuple):
    log_ns: int
    connection: Connection | None  # None: start of a chunk, which has not been read yet
    data: bytes


class _NoIndexError(ReaderError):
    """The file was written without an index, which is not damage."""


class McapFile(McapReader):
    """An MCAP file, read by its index, or by a scan of all records where the index is unusable.

    rosbags reads the index. This class adds a limit for unpacking, skips damaged chunks without
    losing other messages, and reads files that were cut off.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.is_cut_off = False
        self.index_error: str | None = None
        """Why the index was unusable; None if it was used or the file has no index."""
        self.damage: dict[int, DamagedChunk] = {}
        """Damaged chunks that were found so far, by offset in the file."""
        self._path = path

    def open(self) -> None:
        """Find the chunks and topics. Damage of the file raises no error."""
        try:
            super().open()
            self._check_index()
        except DAMAGE as error:
            # rosbags raises a KeyError for a QoS profile that lacks an entry.
            if not isinstance(error, _NoIndexError | KeyError):
                self.index_error = one_line(error)
            self._scan()

    def meta_scan(self) -> None:
        """Refuse rosbags' own scan, which unpacks without a limit."""
        raise _NoIndexError

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages in order of log time: the topic, the log time (ns) and the bytes.

        In a file without chunks, the order is that of the file. A damaged chunk is added to
        `damage`.
        """
        by_id = {connection.id: connection for connection in connections}
        first_ns, end_ns = start or 0, _MAX_TIME_NS if stop is None else stop
        parts = [
            self._items(chunk, by_id, first_ns, end_ns)
            for chunk in self.chunks
            if first_ns <= chunk.message_end_time
            and chunk.message_start_time < end_ns
            and any(chunk.channel_count.get(channel) for channel in by_id)
        ]
        items = heapq.merge(*parts, key=lambda item: item.log_ns)
        for log_ns, connection, data in items if self.chunks else self._unchunked(by_id):
            if connection is not None and first_ns <= log_ns < end_ns:
                yield connection, log_ns, data

    def _items(
        self, chunk: ChunkInfo, by_id: dict[int, Connection], first_ns: int, end_ns: int
    ) -> Iterator[_Item]:
        """Yield a chunk's messages in order of log time; a damaged chunk yields no messages.

        The first item is empty, with the time of the chunk's first message. The chunk is read only
        after it, so that few chunks are in memory at the same time.
        """
        yield _Item(chunk.message_start_time, None, b'')
        try:
            found = [
                _Item(log_ns, by_id[channel_id], data)
                for channel_id, log_ns, data in chunks.messages(self._read_chunk(chunk))
                if channel_id in by_id and first_ns <= log_ns < end_ns
            ]
        except DAMAGE as error:
            self._note_damage(chunk.chunk_start_offset, one_line(error), chunk.channel_count)
            return
        yield from sorted(found, key=lambda item: item.log_ns)

    def _read_chunk(self, chunk: ChunkInfo) -> bytes:
        assert self.bio is not None
        self.bio.seek(chunk.chunk_start_offset + _RECORD_HEAD_BYTES)
        content = self.bio.read(chunk.chunk_length - _RECORD_HEAD_BYTES)
        found = Chunk.read(ReadDataStream(BytesIO(content)))
        size, compression = found.uncompressed_size, found.compression
        if (size, compression) != (chunk.uncompressed_size, chunk.compression):
            raise ReaderError('a chunk contradicts the index')
        return chunks.unpack(found.data, compression, size, found.uncompressed_crc)

    def _unchunked(self, by_id: dict[int, Connection]) -> Iterator[_Item]:
        with suppress(*DAMAGE):  # ends where the file was cut off
            for record, _ in self._records():
                if isinstance(record, Message) and record.channel_id in by_id:
                    yield _Item(record.log_time, by_id[record.channel_id], record.data)

    def _note_damage(self, offset: int, reason: str, counts: Mapping[int, int]) -> None:
        names = {connection.id: connection.topic for connection in self.connections}
        num_lost: Counter[str] = Counter()
        for channel_id, number in counts.items():
            num_lost[names.get(channel_id, 'unknown topics')] += number
        self.damage[offset] = DamagedChunk(self._path, offset, reason, +num_lost)

    def _check_index(self) -> None:
        """Check that the counts in the index agree, and set the times; ReaderError if not."""
        assert self.statistics is not None
        filled = [chunk for chunk in self.chunks if any(chunk.channel_count.values())]
        num_chunks = self.statistics.chunk_count
        if num_chunks and self.metadata.message_count and not filled:
            raise _NoIndexError
        in_chunks: Counter[int] = Counter()
        for chunk in filled:
            in_chunks.update(chunk.channel_count)
        counted = {c.id: c.msgcount for c in self.connections if c.msgcount}
        if num_chunks != len(self.chunks) or (num_chunks and in_chunks != counted):
            raise ReaderError('the index contradicts itself')
        if filled:
            self._set_times(
                min(chunk.message_start_time for chunk in filled),
                max(chunk.message_end_time for chunk in filled),
            )

    def _set_times(self, first_ns: int, last_ns: int) -> None:
        self.metadata = self.metadata._replace(start_time=first_ns, end_time=last_ns + 1)

    def _scan(self) -> None:
        """Find chunks and topics by reading the file from its start up to unreadable data.

        `is_cut_off` is set unless the end of the data section is found.
        """
        if self.bio is not None:
            self.close()
        self.bio = self._path.open('rb')
        self.is_cut_off = True
        scan = _Scan()
        with suppress(*DAMAGE):  # ends at the end of the file, or where it has no records any more
            for record, end in self._records():
                scan.add(record, end)
                if isinstance(record, DataEnd):
                    self.is_cut_off = False
                    break
        self.chunks.extend(scan.chunks)
        self.connections.extend(
            Connection(
                channel.id,
                channel.topic,
                scan.type_names.get(channel.schema_id, '__schemaless__'),
                _NO_DEFINITION,
                '',
                scan.counts[channel.id],
                interfaces.ConnectionExtRosbag2(
                    channel.message_encoding,
                    stored_qos(channel.metadata.get('offered_qos_profiles', '')),
                ),
                self,
            )
            for channel in scan.channels.values()
        )
        for offset, (reason, counts) in scan.damage.items():
            self._note_damage(offset, reason, counts)
        self.metadata = self.metadata._replace(message_count=scan.counts.total())
        self._set_times(scan.first_ns, scan.last_ns)

    def _records(self) -> Iterator[tuple[McapRecord, int]]:
        with self._path.open('rb') as file:
            reader = _Records(file, emit_chunks=True, record_size_limit=chunks.MAX_CHUNK_BYTES)
            for record in reader.records:
                yield record, file.tell()


class _Records(StreamReader):
    """StreamReader that raises an error at zeros, which it would otherwise take for records."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode == chunks.NO_RECORD:
            raise ReaderError('zeros where a record should be')
        return super()._read_record(opcode, length)


class _Scan:
    """Chunks, topics and message counts collected from the records of a file."""

    def __init__(self) -> None:
        self.chunks: list[ChunkInfo] = []
        self.damage: dict[int, tuple[str, Counter[int]]] = {}  # by offset: reason, lost messages
        self.type_names: dict[int, str] = {}  # name of the type by id of the schema
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()  # readable messages by channel
        self.first_ns, self.last_ns = _MAX_TIME_NS, 0
        # Lost messages of the last chunk, by channel; None: the chunk is readable.
        self._lost: Counter[int] | None = None

    def add(self, record: McapRecord, end: int) -> None:
        """Add a record to the chunks, topics and counts; a chunk ends at `end` in the file."""
        match record:
            case Chunk():
                self._add_chunk(record, end)
            case MessageIndex() if self._lost is not None:
                self._lost[record.channel_id] += len(record.records)
            case Schema():
                self.type_names[record.id] = record.name
            case Channel():
                self.channels[record.id] = record
            case Message():
                self._add_times(Counter([record.channel_id]), record.log_time, record.log_time)

    def _add_chunk(self, chunk: Chunk, end: int) -> None:
        head_bytes = _RECORD_HEAD_BYTES + _CHUNK_HEAD_BYTES + len(chunk.compression.encode())
        offset = end - len(chunk.data) - head_bytes
        self._lost = None
        try:
            data = chunks.unpack(
                chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc
            )
            found = [(message.channel_id, message.log_ns) for message in chunks.messages(data)]
            self._add_definitions(data)
        except DAMAGE as error:
            self._lost = Counter()
            self.damage[offset] = one_line(error), self._lost
            return
        if found:
            counts = Counter(channel_id for channel_id, _ in found)
            times = [log_ns for _, log_ns in found]
            self._add_times(counts, min(times), max(times))
            self.chunks.append(
                ChunkInfo(
                    min(times), max(times), offset, end - offset, {}, 0, chunk.compression,
                    len(chunk.data), chunk.uncompressed_size, counts,
                )
            )  # fmt: skip

    def _add_definitions(self, chunk: bytes) -> None:
        for opcode, start, end in chunks.split_records(chunk):
            stream = ReadDataStream(BytesIO(chunk[start:end]))
            if opcode == Opcode.SCHEMA:
                self.add(Schema.read(stream), end)
            elif opcode == Opcode.CHANNEL:
                self.add(Channel.read(stream), end)

    def _add_times(self, counts: Counter[int], first_ns: int, last_ns: int) -> None:
        self.counts += counts
        self.first_ns, self.last_ns = min(self.first_ns, first_ns), max(self.last_ns, last_ns)
