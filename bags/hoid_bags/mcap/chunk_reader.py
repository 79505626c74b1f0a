"""Indexed MCAP files, read chunk by chunk: what is damaged is left out and noted."""

from __future__ import annotations

import heapq
import struct
from collections import Counter
from collections.abc import Collection, Generator, Iterator
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from hoid_bags.mcap.chunks import DAMAGE, Damage, messages, one_line, unpack, unpack_message
from hoid_common.io.untrusted import open_regular
from hoid_common.values import NS_PER_S

_HEAD = struct.Struct('<BQQQQII')  # opcode, size; first and last time, size, checksum; length
_MAX_TIME_NS = 2**63
_MOST_OFF_NS = NS_PER_S  # recorders may count a little otherwise


class _Item(NamedTuple):
    log_ns: int
    connection: Connection | None  # None opens a chunk, before it is read
    data: bytes


class TolerantMcapReader(McapReader):
    """A file of rosbags' reader whose damaged chunks cost no more than themselves."""

    def __init__(self, path: Any) -> None:
        """Prepare to read; raises InputError for what is no regular file."""
        open_regular(Path(path)).close()
        super().__init__(path)
        self.damage: dict[int, Damage] = {}  # met so far, by place in the file

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages of these connections, from `start` to before `stop`, in order of time."""
        if not self.chunks:
            yield from super().messages(connections, start, stop)
            return
        by_id = {connection.id: connection for connection in connections}
        first_ns, end_ns = start or 0, _MAX_TIME_NS if stop is None else stop
        parts = [
            self._items(chunk, by_id, first_ns, end_ns)
            for chunk in self.chunks
            if first_ns <= chunk.message_end_time
            and chunk.message_start_time < end_ns
            and any(chunk.channel_count.get(channel) for channel in by_id)
        ]
        for log_ns, connection, data in heapq.merge(*parts, key=lambda item: item.log_ns):
            if connection is not None:
                yield connection, log_ns, data

    def _items(
        self, chunk: ChunkInfo, by_id: dict[int, Connection], first_ns: int, end_ns: int
    ) -> Iterator[_Item]:
        """Yield a chunk's messages in order of time; it is read only once it is its turn."""
        yield _Item(chunk.message_start_time, None, b'')
        try:
            found = [
                _Item(log_ns, by_id[channel_id], data)
                for channel_id, log_ns, data in messages(self._records(chunk))
                if channel_id in by_id and first_ns <= log_ns < end_ns
            ]
        except DAMAGE as error:
            self._note(chunk, error)
            return
        yield from sorted(found, key=lambda item: item.log_ns)

    def _records(self, chunk: ChunkInfo) -> bytes:
        assert self.bio is not None
        self.bio.seek(chunk.chunk_start_offset)
        _, _, _, _, size, checksum, length = _HEAD.unpack(self.bio.read(_HEAD.size))
        compression = self.bio.read(min(length, _HEAD.size)).decode()
        if (size, compression) != (chunk.uncompressed_size, chunk.compression):
            raise ValueError('a chunk is not what the index says')
        self.bio.seek(8, 1)  # the packed size, which the index has too
        data = self.bio.read(chunk.compressed_size)
        return unpack(data, compression, size, checksum)

    def _note(self, chunk: ChunkInfo, error: Exception) -> None:
        lost: Counter[str] = Counter()
        for connection in self.connections:
            lost[connection.topic] += chunk.channel_count.get(connection.id, 0)
        offset = chunk.chunk_start_offset
        self.damage[offset] = Damage(Path(str(self.path)), offset, one_line(error), +lost)


class _FolderReader(DirectoryReader):
    """A folder whose metadata may not make messages of its files disappear."""

    STORAGE_PLUGINS = MappingProxyType(
        {**DirectoryReader.STORAGE_PLUGINS, 'mcap': TolerantMcapReader}
    )

    def open(self) -> None:
        """Open all files; raises ReaderError where they are not what metadata.yaml says."""
        super().open()
        self._has_packed_messages = self.metadata.compression_mode == 'message'
        # Its own way to unpack them has no limit.
        self.metadata = self.metadata._replace(compression_mode=None)
        try:
            self._check_files()
            self._check_topics()
            self._check_times()
        except ReaderError:
            self.close()
            raise

    def _check_files(self) -> None:
        names = [
            Path(str(storage.path)).name
            for storage in self.storages
            if isinstance(storage, (McapReader, Sqlite3Reader))
        ]
        if len(set(names)) < len(names):
            raise ReaderError('metadata.yaml names a file twice')
        found = sum(c.msgcount for storage in self.storages for c in storage.connections)
        others = {path.name for path in Path(str(self.path)).glob('*.mcap')} - set(names)
        if others and found < self.metadata.message_count:
            raise ReaderError(f'metadata.yaml leaves out {min(others)}')

    def _check_topics(self) -> None:
        told = [(c.topic, c.msgtype, c.ext) for c in self.connections]
        for storage in self.storages:
            for found in storage.connections:
                if found.msgcount and (found.topic, found.msgtype, found.ext) not in told:
                    raise ReaderError(f'metadata.yaml says otherwise of {found.topic}')

    def _check_times(self) -> None:
        chunks = [
            chunk
            for storage in self.storages
            if isinstance(storage, TolerantMcapReader)
            for chunk in storage.chunks
            if any(chunk.channel_count.values())
        ]
        if not chunks:
            return
        first_ns = min(chunk.message_start_time for chunk in chunks)
        last_ns = max(chunk.message_end_time for chunk in chunks)
        told = self.metadata
        off_ns = max(abs(told.start_time - first_ns), abs(told.end_time - last_ns))
        if off_ns > _MOST_OFF_NS:
            raise ReaderError('metadata.yaml says otherwise of when messages came')

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages of these connections as `TolerantMcapReader` does."""
        for connection, log_ns, data in super().messages(connections, start, stop):
            is_packed = self._has_packed_messages
            yield connection, log_ns, unpack_message(data) if is_packed else data


class TolerantReader(Reader):
    """rosbags' reader of whole bags; MCAP files give what is readable of them."""

    STORAGE_PLUGINS = MappingProxyType(
        {**Reader.STORAGE_PLUGINS, 'dir': _FolderReader, '.mcap': TolerantMcapReader}
    )

    @property
    def damage(self) -> list[Damage]:
        """Return the damaged chunks that were met so far."""
        storages = getattr(self.storage, 'storages', [self.storage])
        files = [storage for storage in storages if isinstance(storage, TolerantMcapReader)]
        return [damage for file in files for damage in file.damage.values()]
