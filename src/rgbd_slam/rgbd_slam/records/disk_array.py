"""Arrays that grow in a temporary file, so that the operating system can take their memory."""

from __future__ import annotations

import logging
import math
import mmap
import os
import tempfile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.files import write_error
from rgbd_slam.records.record_store import temporary_folder, write_at

_logger = logging.getLogger(__name__)

Array = NDArray[Any]


class DiskArray:
    """An array of rows that `grow` moves to an anonymous temporary file, mapped into memory.

    The space on the disk is reserved before it is used, because a mapped file ends the process
    with SIGBUS on a full disk. Where it cannot be reserved, the array stays in memory.

    Args:
        rows: The first rows (N, ...). They are `array` itself until `grow` copies them.
    """

    def __init__(self, rows: Array) -> None:
        self.array = rows  # (N, ...), another object after `grow`
        self._map: mmap.mmap | None = None
        self._file: IO[bytes] | None = None
        self._has_failed = False

    def grow(self, num_rows: int) -> None:
        """Enlarge the array to `num_rows` rows; the new rows are zero.

        `array` is another object afterwards.

        If the file cannot be enlarged, a warning is logged, and the array is in memory from then
        on.
        """
        old = self.array
        shape = num_rows, *old.shape[1:]
        if not self._has_failed:
            try:
                self._grow_file(math.prod(shape) * old.itemsize)
            except OSError as error:
                self._log_failure(error)
        if self._map is None:
            self.array = np.zeros(shape, old.dtype)
        else:
            self.array = np.frombuffer(self._map, old.dtype).reshape(shape)
        if not self._is_in_file(old):
            self.array[: len(old)] = old

    def write_rows(self, first: int, rows: Array) -> None:
        """Replace the rows from row `first` on by `rows`.

        Writing to the file takes half the time of filling its mapped pages one by one.

        Raises:
            OSError: The file cannot be written.
        """
        if self._file is None or self._map is None:
            self.array[first : first + len(rows)] = rows
            return
        data = rows.reshape(-1).view(np.uint8).data
        write_at(self._file.fileno(), data, first * rows[:1].nbytes)

    def release_memory(self) -> None:
        """Let the operating system take the memory; the content is read again when it is used.

        An array without a file stays in memory.
        """
        if self._map is not None:
            self._map.madvise(mmap.MADV_DONTNEED)

    def _grow_file(self, num_bytes: int) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=temporary_folder(), buffering=0)  # noqa: SIM115
        os.posix_fallocate(self._file.fileno(), 0, num_bytes)
        self._map = mmap.mmap(self._file.fileno(), num_bytes)

    def _is_in_file(self, old: Array) -> bool:
        return self._map is not None and isinstance(_owner(old), mmap.mmap)

    def _log_failure(self, error: OSError) -> None:
        self._has_failed, self._map, self._file = True, None, None
        _logger.warning(
            '%s; features of the map stay in memory; set TMPDIR to another folder',
            write_error(temporary_folder(), error),
        )


def _owner(array: Array) -> object:
    """Return the object that holds the memory of an array."""
    owner: Any = array
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    return owner
