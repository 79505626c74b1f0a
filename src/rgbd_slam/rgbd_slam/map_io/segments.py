"""Segments: files to which the rows of records are only ever appended, in chunks.

A chunk is the arrays of a record, one after the other. A segment does not contain how much of it
is valid: the numbers of rows of its chunks and its checksum are stored elsewhere (in the index of
the checkpoint) once the rows are on the disk. Rows that a killed process has appended after that
are not read.
"""

from __future__ import annotations

import math
import mmap
import os
import secrets
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.io.records import Array, Column, Record
from hoid_common.values import IntArray
from rgbd_slam.records.disk_array import write_at


def num_rows(record: Record) -> int:
    """Return the number of rows of a record with a single named axis."""
    return next(iter(record.lengths().values()))


class Segment:
    """A segment that is being written.

    Args:
        folder: Its folder.
        name: First part of the name of the file; a random part follows.
        record: The type of its records, which have a single named axis, the first one.
    """

    def __init__(self, folder: Path, name: str, record: type[Record]) -> None:
        self.path = folder / f'{name}-{secrets.token_hex(4)}'
        self.chunks: list[int] = []  # numbers of rows
        self.num_rows = self.num_bytes = self.crc = 0
        self._row_bytes = _row_bytes(record)
        self._descriptor: int | None = None

    def append(self, record: Record) -> int:
        """Append the rows of a record as a chunk, and return the row number of the first one.

        A record without rows adds no chunk.

        Raises:
            FileNotFoundError: The folder is missing, or somebody has deleted the file since the
                last `sync`.
            OSError: The rows cannot be written; the valid part of the segment is as before.
        """
        first, count = self.num_rows, num_rows(record)
        if count == 0:
            return first
        if self._descriptor is None:
            create = os.O_CREAT if self.num_bytes == 0 else 0
            self._descriptor = os.open(self.path, os.O_WRONLY | create, 0o644)
        end, crc = self.num_bytes, self.crc
        for array in record.arrays().values():
            data = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
            write_at(self._descriptor, data, end)
            end, crc = end + len(data), zlib.crc32(data, crc)
        self.num_bytes, self.crc = end, crc
        self.num_rows += count
        self.chunks.append(count)
        return first

    def sync(self) -> None:
        """Wait until all rows are on the disk, and close the file until the next `append`.

        It is closed because a disk with a file that is open for writing cannot be made read-only.

        Raises:
            OSError: The rows cannot be written.
        """
        if self._descriptor is not None:
            os.fsync(self._descriptor)
            self.close()

    def close(self) -> None:
        """Close the file, if it is open."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def is_wasteful(self, num_alive: int, spare_bytes: int) -> bool:
        """Return whether the unused rows are larger than the used ones by over `spare_bytes`.

        Args:
            num_alive: Number of the rows that are still used.
            spare_bytes: Unused bytes that are accepted in addition to those of the used rows.
        """
        return self.num_bytes > 2 * num_alive * self._row_bytes + spare_bytes


class Rows(NamedTuple):
    """The valid rows of a segment by chunk, read-only; those of a file are mapped into memory."""

    record: type[Record]
    chunks: list[dict[str, Array]]
    starts: IntArray  # (C,) number of the first row of each chunk

    @classmethod
    def read(cls, path: Path, record: type[Record], chunks: Sequence[int], crc: int) -> Rows:
        """Return the rows of a segment file, mapped into memory, after checking their checksum.

        Args:
            path: The file.
            record: The type of its records.
            chunks: Numbers of rows of the chunks.
            crc: CRC-32 of all chunks.

        Raises:
            MapFileError: The file cannot be read, is shorter than its chunks, or has another
                checksum.
        """
        counts = np.array(chunks, np.int64)
        size = int(counts.sum()) * _row_bytes(record)
        try:
            data = _mapped(path, size) if size else b''
        except OSError as error:
            raise MapFileError(f'{path.name} cannot be read: {error.strerror}') from error
        if zlib.crc32(data) != crc:
            raise MapFileError(f'{path.name} is damaged')
        parts, start = [], 0
        for count in chunks:
            part = {}
            for name, column in record.columns().items():
                shape = _shape(column, count)
                num_values = math.prod(shape)
                part[name] = np.frombuffer(data, column.dtype, num_values, start).reshape(shape)
                start += num_values * column.dtype.itemsize
            parts.append(part)
        return cls(record, parts, np.cumsum(counts) - counts)

    def all(self) -> dict[str, Array]:
        """Return copies of all rows by column, in the order in which they were appended."""
        return self._joined([(part, slice(None)) for part in self.chunks])

    def taken(self, first: IntArray, count: IntArray) -> dict[str, Array]:
        """Return copies of runs of rows by column, one run after the other.

        Args:
            first: (N,) row number of the first row of each run. A run lies within one chunk.
            count: (N,) number of rows of each run.
        """
        chunk = np.searchsorted(self.starts, first, side='right') - 1
        start = first - self.starts[chunk]
        runs = zip(chunk.tolist(), start.tolist(), count.tolist(), strict=True)
        return self._joined([(self.chunks[c], slice(s, s + n)) for c, s, n in runs if n])

    def _joined(self, runs: list[tuple[dict[str, Array], slice]]) -> dict[str, Array]:
        return {
            name: np.concatenate(
                [np.empty(_shape(column, 0), column.dtype), *(part[name][of] for part, of in runs)]
            )
            for name, column in self.record.columns().items()
        }


def _row_bytes(record: type[Record]) -> int:
    return sum(math.prod(_shape(c, 1)) * c.dtype.itemsize for c in record.columns().values())


def _shape(column: Column, count: int) -> tuple[int, ...]:
    return tuple(axis if isinstance(axis, int) else count for axis in column.axes)


def _mapped(path: Path, size: int) -> memoryview[Any]:
    """Return the first bytes of a file, mapped into memory.

    Raises:
        MapFileError: The file is shorter.
    """
    with path.open('rb') as file:
        if os.fstat(file.fileno()).st_size < size:
            raise MapFileError(f'{path.name} is cut off')
        return memoryview(mmap.mmap(file.fileno(), size, prot=mmap.PROT_READ))
