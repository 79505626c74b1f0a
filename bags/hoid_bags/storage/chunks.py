"""MCAP chunks: unpacking within limits, verification by checksum, splitting into records."""

from __future__ import annotations

import struct
from bz2 import BZ2Decompressor
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from zlib import crc32

import apsw
from backports.zstd import ZstdDecompressor, ZstdError
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import ReaderError
from rosbags.serde.errors import SerdeError

MAX_CHUNK_BYTES: Final = 1 << 28
"""Largest unpacked chunk or message. Chosen: rosbags and mcap close a chunk after 1 MiB."""

DAMAGE = (
    ReaderError, Ros1Error, SerdeError, McapError, ZstdError, OSError, ValueError, LookupError,
    TypeError, EOFError, RuntimeError, MemoryError, OverflowError, AssertionError, AttributeError,
    struct.error, apsw.Error,
)  # fmt: skip
"""Exceptions that the libraries and this module raise for bytes that are no valid recording."""

ZSTD_MAGIC: Final = b'\x28\xb5\x2f\xfd'
"""First bytes of zstd data. A message that is not compressed begins with 0 (CDR)."""
NO_RECORD: Final = 0
"""Opcode that MCAP does not allow. After a power cut, a file may end in zeros."""
_MESSAGE: Final = 0x05
_RECORD = struct.Struct('<BQ')  # opcode, number of bytes that follow
_MESSAGE_HEAD = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time
_UNPACKERS: Mapping[str, Callable[[bytes, int], bytes]] = {
    '': lambda data, _: data,
    'zstd': lambda data, limit: ZstdDecompressor().decompress(data, limit),
    'lz4': lambda data, limit: bytes(LZ4FrameDecompressor().decompress(data, limit)),
    'bz2': lambda data, limit: BZ2Decompressor().decompress(data, limit),
}


class Record(NamedTuple):
    """Position of one record in a chunk."""

    opcode: int
    start: int  # first byte of its content
    end: int  # byte after its content


class ChunkMessage(NamedTuple):
    """One message of a chunk, still serialized."""

    channel_id: int
    log_ns: int
    data: bytes  # the serialized message


class DamagedChunk(NamedTuple):
    """A chunk of an MCAP file that cannot be read."""

    path: Path
    offset: int  # position in the file
    reason: str
    num_lost: Mapping[str, int]  # lost messages by topic, as far as the index counts them


def unpack(data: bytes, compression: str, size: int | None = None, checksum: int = 0) -> bytes:
    """Return the records of a chunk: `size` bytes, or at most MAX_CHUNK_BYTES if it is unknown.

    rosbags and mcap verify the size only after they have unpacked everything. Here at most one
    byte more is unpacked, so that a small file cannot fill the memory. Raises one of `DAMAGE`: the
    compression is unknown, or the content contradicts `size` or a checksum (CRC-32) that is not 0.
    """
    if size is not None and size > MAX_CHUNK_BYTES:
        raise ReaderError(f'a chunk claims {size} bytes, more than {MAX_CHUNK_BYTES}')
    if compression not in _UNPACKERS:
        raise ReaderError(f'unknown compression "{compression}"')
    limit = MAX_CHUNK_BYTES if size is None else size
    records = _UNPACKERS[compression](data, limit + 1)
    if len(records) > limit or size not in (None, len(records)):
        raise ReaderError(f'a chunk of {limit} bytes unpacks to another size')
    if checksum and crc32(records) != checksum:
        raise ReaderError('checksum mismatch')
    return records


def unpack_message(data: bytes) -> bytes:
    """Return a message that was compressed on its own, or raise one of `DAMAGE`."""
    unpacker = ZstdDecompressor()
    message = unpacker.decompress(data, MAX_CHUNK_BYTES)
    if not unpacker.eof:
        raise ReaderError(f'a message is truncated, or unpacks to over {MAX_CHUNK_BYTES} bytes')
    return message


def split_records(chunk: bytes) -> Iterator[Record]:
    """Yield the positions of the records in an unpacked chunk, or raise one of `DAMAGE`."""
    at = 0
    while at < len(chunk):
        opcode, size = _RECORD.unpack_from(chunk, at)
        at += _RECORD.size
        if opcode == NO_RECORD:
            raise ReaderError('zeros where a record should be')
        if size > len(chunk) - at:
            raise ReaderError(f'a record of {size} bytes exceeds its chunk')
        yield Record(opcode, at, at + size)
        at += size


def messages(chunk: bytes) -> Iterator[ChunkMessage]:
    """Yield the messages of an unpacked chunk in the order of the file."""
    for opcode, start, end in split_records(chunk):
        if opcode == _MESSAGE:
            channel_id, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(chunk, start)
            yield ChunkMessage(channel_id, log_ns, chunk[start + _MESSAGE_HEAD.size : end])


def one_line(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def describe_damage(damage: Sequence[DamagedChunk]) -> str:
    """Return a line of text: the number of lost messages by topic, and the first damaged place."""
    num_lost: Counter[str] = Counter()
    for chunk in damage:
        num_lost.update(chunk.num_lost)
    first = min(damage, key=lambda chunk: (chunk.path, chunk.offset))
    topics = ', '.join(f'{number} of {topic}' for topic, number in sorted(num_lost.items()))
    chunks = 'chunk is' if len(damage) == 1 else 'chunks are'
    return (
        f'damaged: {len(damage)} {chunks} left out'
        f'{f" with messages: {topics}" if topics else ""}; '
        f'first at byte {first.offset} of {first.path.name}: {first.reason}'
    )
