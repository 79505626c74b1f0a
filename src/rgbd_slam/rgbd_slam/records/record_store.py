"""A growing list of records of one size, in a temporary file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_slam.records.disk_array import DiskArray

BLOCK = 1024  # records that are read together; chosen: 34 s of frames at 30 Hz
_GROWTH = 1 / 8  # chosen: share of the records for which space is reserved at once


class RecordStore:
    """A list of records of one structured type, whose old ones need no memory (`DiskArray`)."""

    def __init__(self, dtype: np.dtype[np.void], what: str) -> None:
        self._rows = DiskArray(np.empty(BLOCK, dtype), what)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def num_unwritten(self) -> int:
        """Return the number of records in memory for which the file has no space."""
        return self._count if self._rows.has_failed else 0

    def append(self, record: tuple[Any, ...]) -> None:
        if self._count == len(self._rows.array):
            self._rows.grow(self._count + max(BLOCK, int(_GROWTH * self._count)))
        self._rows.array[self._count] = record
        self._count += 1
        if self._count % BLOCK == 0:
            self._rows.release_memory()

    def __getitem__(self, n: int) -> np.void:
        record: np.void = self._rows.array[n].copy()
        return record

    def __setitem__(self, n: int, record: np.void) -> None:
        self._rows.array[n] = record

    def newest(self) -> NDArray[np.void]:
        """Return copies of the newest records (N,): 1025 to 2048, or all if there are fewer."""
        last_block = max(0, self._count - 1) // BLOCK
        return self._rows.array[BLOCK * max(0, last_block - 1) : self._count].copy()

    def blocks(self, count: int) -> Iterator[NDArray[np.void]]:
        """Yield the first `count` records in blocks, uncopied; any thread may iterate."""
        for first in range(0, count, BLOCK):
            yield self._rows.array[first : min(first + BLOCK, count)]
