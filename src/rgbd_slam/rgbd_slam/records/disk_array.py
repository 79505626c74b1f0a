"""Growing arrays in a temporary file, whose memory the operating system can reclaim."""

from __future__ import annotations

import errno
import logging
import math
import mmap
import os
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.files import write_error

_FOLDER = '/var/tmp'  # noqa: S108 - the file has no name. /tmp is often in memory.

_logger = logging.getLogger(__name__)

Array = NDArray[Any]


def temporary_folder() -> Path:
    """Return the folder for temporary files: `TMPDIR`, or else /var/tmp."""
    return Path(os.environ.get('TMPDIR') or _FOLDER)


class DiskArray:
    """An array of rows, which `grow` moves to an unnamed temporary file mapped into memory.

    Disk space is reserved before it is used, because on a full disk, writing to a mapped file ends
    the process by SIGBUS. While it cannot be reserved, the array is in memory.

    Args:
        rows: The first rows (N, ...), which are `array` itself until `grow` copies them.
        what: A plural noun that names the rows in a log line.
    """

    def __init__(self, rows: Array, what: str) -> None:
        # (N, ...); `grow` replaces the array by another object.
        self.array, self._what = rows, what
        self._map: mmap.mmap | None = None
        self._file: IO[bytes] | None = None
        self.has_failed = False  # whether `grow` could not enlarge the file

    def grow(self, num_rows: int) -> None:
        """Enlarge `array` to `num_rows` rows, of which the new ones are zero."""
        old, was_in_file = self.array, self._map is not None
        shape = num_rows, *old.shape[1:]
        try:
            self._grow_file(math.prod(shape) * old.itemsize)
        except OSError as error:
            self._log_failure(error)
        if self._map is None:
            array = np.zeros(shape, old.dtype)
        else:
            array = np.frombuffer(self._map, old.dtype).reshape(shape)
        if not (was_in_file and self._map is not None):
            array[: len(old)] = old
        self.array = array  # last, because other threads may read it at any time

    def write_rows(self, first: int, rows: Array) -> None:
        """Replace the rows from `first` on by `rows`, twice as fast as assigning to `array`."""
        if self._file is None:
            self.array[first : first + len(rows)] = rows
            return
        data = rows.reshape(-1).view(np.uint8).data
        if os.pwrite(self._file.fileno(), data, first * rows[:1].nbytes) < len(data):
            # It cannot be a full disk, since the space was reserved.
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def release_memory(self) -> None:
        """Let the operating system reclaim the memory of rows in the file until they are used."""
        if self._map is not None:
            self._map.madvise(mmap.MADV_DONTNEED)

    def _grow_file(self, num_bytes: int) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=temporary_folder(), buffering=0)  # noqa: SIM115
        os.posix_fallocate(self._file.fileno(), 0, num_bytes)
        self._map = mmap.mmap(self._file.fileno(), num_bytes)
        self.has_failed = False

    def _log_failure(self, error: OSError) -> None:
        self._map = self._file = None
        if not self.has_failed:
            _logger.warning(
                '%s; %s stay in memory; set TMPDIR to another folder',
                write_error(temporary_folder(), error),
                self._what,
            )
        self.has_failed = True
