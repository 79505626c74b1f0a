"""The content of MCAP chunks: unpacked within bounds, held against its checksum, and walked."""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from zlib import crc32

from backports.zstd import ZstdDecompressor, ZstdError
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.exceptions import McapError
from rosbags.rosbag2 import ReaderError

MAX_CHUNK_BYTES: Final = 1 << 28
"""Unpacked: a hundred times what recorders fill; more is a mistake or an attack."""

DAMAGE = (
    ReaderError, McapError, ZstdError, OSError, ValueError, LookupError, TypeError, EOFError,
    RuntimeError, MemoryError, OverflowError, AssertionError, struct.error, sqlite3.Error,
)  # fmt: skip
"""What reading bytes that make no sense ends in."""

NO_RECORD: Final = 0
"""Opcode of none: what a power cut leaves of a file may end in zeros."""
_MESSAGE: Final = 0x05
_RECORD = struct.Struct('<BQ')  # opcode, bytes that follow
_MESSAGE_HEAD = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time
_UNPACKERS: Mapping[str, Callable[[bytes, int], bytes]] = {
    '': lambda data, _: data,
    'zstd': lambda data, limit: ZstdDecompressor().decompress(data, limit),
    'lz4': lambda data, limit: bytes(LZ4FrameDecompressor().decompress(data, limit)),
}


class Record(NamedTuple):
    """One record of a chunk."""

    opcode: int
    start: int  # of its content in the chunk
    end: int


class ChunkMessage(NamedTuple):
    """One message of a chunk, still serialised."""

    channel_id: int
    log_ns: int
    data: bytes


class Damage(NamedTuple):
    """A chunk that cannot be read."""

    path: Path
    offset: int  # in the file
    reason: str
    lost: Mapping[str, int]  # messages by topic, as far as the file tells


def unpack(data: bytes, compression: str, size: int, checksum: int) -> bytes:
    """Return a chunk's records.

    Args:
        data: As in the file.
        compression: '', 'zstd' or 'lz4'.
        size: Of the records; nothing beyond it is unpacked.
        checksum: CRC-32 of the records; 0 means none.

    Raises:
        ReaderError: The chunk contradicts itself or its checksum, or is larger than any.
    """
    if size > MAX_CHUNK_BYTES:
        raise ReaderError(f'a chunk of {size} bytes is larger than any')
    if compression not in _UNPACKERS:
        raise ReaderError(f'unknown compression "{compression}"')
    records = _UNPACKERS[compression](data, size + 1)
    if len(records) != size:
        raise ReaderError(f'a chunk of {size} bytes unpacks to another size')
    if checksum and crc32(records) != checksum:
        raise ReaderError('checksum mismatch')
    return records


def unpack_message(data: bytes) -> bytes:
    """Return a message that was packed by itself; raises ReaderError for more than any."""
    unpacker = ZstdDecompressor()
    message = unpacker.decompress(data, MAX_CHUNK_BYTES)
    if not unpacker.eof:
        raise ReaderError(f'a message is cut off, or unpacks to over {MAX_CHUNK_BYTES} bytes')
    return message


def walk(records: bytes) -> Iterator[Record]:
    """Yield where the records of a chunk lie; raises ReaderError where there is none."""
    at = 0
    while at < len(records):
        opcode, size = _RECORD.unpack_from(records, at)
        at += _RECORD.size
        if opcode == NO_RECORD:
            raise ReaderError('zeros where a record should be')
        if size > len(records) - at:
            raise ReaderError(f'a record of {size} bytes goes beyond its chunk')
        yield Record(opcode, at, at + size)
        at += size


def messages(records: bytes) -> Iterator[ChunkMessage]:
    """Yield the messages of a chunk in its order; raises as `walk`."""
    for opcode, start, end in walk(records):
        if opcode == _MESSAGE:
            channel_id, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(records, start)
            yield ChunkMessage(channel_id, log_ns, records[start + _MESSAGE_HEAD.size : end])


def one_line(error: Exception) -> str:
    """Return what an exception says, on one line."""
    return ' '.join(str(error).split()) or type(error).__name__


def describe_damage(damage: Sequence[Damage]) -> str:
    """Return in one line how much is left out, of which topics, and where the first of it lies."""
    lost: Counter[str] = Counter()
    for chunk in damage:
        lost.update(chunk.lost)
    first = min(damage, key=lambda chunk: (chunk.path, chunk.offset))
    topics = ', '.join(f'{number} of {topic}' for topic, number in sorted(lost.items()))
    many = 'chunk is' if len(damage) == 1 else 'chunks are'
    return (
        f'damaged: {len(damage)} {many} left out{f" with messages: {topics}" if topics else ""}; '
        f'first at byte {first.offset} of {first.path.name}: {first.reason}'
    )
