"""A growing list of fixed-size records, of which old ones are in a file."""

from __future__ import annotations

import errno
import logging
import os
import tempfile
import weakref
from collections.abc import Iterator
from threading import Lock, Thread
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import InputError
from hoid_common.io.files import write_error
from rgbd_slam.records.disk_array import temporary_folder

BLOCK = 1024  # number of records that are written together; chosen: 34 s of frames at 30 Hz
_NUM_NEWEST = 2  # number of blocks that stay in memory: the growing one and its predecessor

_logger = logging.getLogger(__name__)


class RecordStore:
    """A list of records of one structured type; old records are in an anonymous temporary file.

    The file is in `TMPDIR`, or else in /var/tmp. A thread writes it, because a disk may be slow.
    Blocks that cannot be written stay in memory and are tried again with the next block. (A
    memory-mapped file would end the process by SIGBUS on a full disk, and stop the tracker on a
    slow one.) `what` is a plural noun that names the records in log lines.
    """

    def __init__(self, dtype: np.dtype[np.void], what: str) -> None:
        self._dtype, self._what = dtype, what
        self._held = {0: np.empty(BLOCK, dtype)}  # by number: blocks in memory
        self._count = 0
        self._folder = temporary_folder()
        self._file: IO[bytes] | None = None
        self._writer: Thread | None = None
        self._lock = Lock()  # protects all blocks except the newest ones
        self._has_failed = False

    def __len__(self) -> int:
        return self._count

    @property
    def num_unwritten(self) -> int:
        """Return the number of records that are in memory because they could not be written."""
        return BLOCK * max(0, len(self._held) - _NUM_NEWEST) if self._has_failed else 0

    def append(self, record: tuple[Any, ...]) -> None:
        number, n = divmod(self._count, BLOCK)
        if number not in self._held:
            self._held[number] = np.empty(BLOCK, self._dtype)
            self._write_old_blocks()
        self._held[number][n] = record
        self._count += 1

    def __getitem__(self, n: int) -> np.void:
        """Return a copy of a record; InputError if the file cannot be read."""
        number, i = divmod(n, BLOCK)
        record: np.void = self._block(number)[i].copy()
        return record

    def __setitem__(self, n: int, record: np.void) -> None:
        """Replace a record; its block stays in memory until blocks are written again."""
        number, i = divmod(n, BLOCK)
        with self._lock:
            if number not in self._held:
                self._held[number] = self._block(number).copy()
            self._held[number][i] = record

    def newest(self) -> NDArray[np.void]:
        """Return copies of the newest records (N,): 1025 to 2048, or all if they are fewer."""
        last = max(0, self._count - 1) // BLOCK
        first = max(0, last + 1 - _NUM_NEWEST)
        blocks = [self._block(number) for number in range(first, last + 1)]
        return np.concatenate(blocks)[: self._count - first * BLOCK]

    def blocks(self, count: int) -> Iterator[NDArray[np.void]]:
        """Yield the first `count` records in blocks, as views if in memory; from any thread."""
        for first in range(0, count, BLOCK):
            yield self._block(first // BLOCK)[: count - first]

    def _block(self, number: int) -> NDArray[np.void]:
        held = self._held.get(number)
        if held is not None:
            return held
        assert self._file is not None
        size = BLOCK * self._dtype.itemsize
        try:
            data = os.pread(self._file.fileno(), size, number * size)
        except OSError as error:
            raise InputError(f'{self._folder}: cannot be read: {error.strerror}') from error
        return np.frombuffer(data, self._dtype)

    def _write_old_blocks(self) -> None:
        if self._writer is not None and self._writer.is_alive():
            return
        old = sorted(self._held)[:-_NUM_NEWEST]
        if old:
            self._writer = Thread(target=self._write, args=(old,), name='records', daemon=True)
            self._writer.start()

    def _write(self, old: list[int]) -> None:
        for number in old:
            with self._lock:
                try:
                    self._write_block(number)
                except OSError as error:
                    self._log_failure(error)
                    return
                del self._held[number]
        self._has_failed = False

    def _write_block(self, number: int) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close).atexit = False
        data = self._held[number].view(np.uint8).data
        if os.pwrite(self._file.fileno(), data, number * len(data)) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _log_failure(self, error: OSError) -> None:
        if not self._has_failed:
            _logger.warning(
                '%s; %s stay in memory until writing succeeds; set TMPDIR to another folder',
                write_error(self._folder, error),
                self._what,
            )
        self._has_failed = True
