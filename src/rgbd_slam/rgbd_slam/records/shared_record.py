"""Records in temporary files that several processes map into memory instead of copying them."""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Mapping
from typing import IO, Any, Generic, NamedTuple, TypeVar

import numpy as np

from hoid_common.io.records import Record
from rgbd_slam.records.disk_array import temporary_folder

R = TypeVar('R', bound=Record)
_ALIGNMENT = 64  # bytes; chosen: a cache line


class RecordLocation(NamedTuple):
    """The location of a `SharedRecord`, which another process receives instead of its arrays."""

    path: str
    kind: type[Record]
    lengths: Mapping[str, int]

    def map(self) -> Any:
        """Return the read-only record, whose memory is shared with the file."""
        arrays, start = {}, 0
        with open(self.path, 'rb') as file:  # noqa: PTH123 - a path below /proc
            data = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
        for name, column in self.kind.columns().items():
            shape = column.shape(self.lengths)
            array = np.frombuffer(data, column.dtype, math.prod(shape), start)
            arrays[name] = array.reshape(shape)
            start += array.nbytes + -array.nbytes % _ALIGNMENT
        return self.kind(**arrays)


class SharedRecord(Generic[R]):
    """A copy of a record in an unnamed temporary file; OSError if the file cannot be written."""

    def __init__(self, record: R) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(dir=temporary_folder())  # noqa: SIM115
        for array in record.arrays().values():
            data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
            self._file.write(data.data)
            self._file.write(bytes(-len(data) % _ALIGNMENT))
        self._file.write(bytes(_ALIGNMENT))  # because an empty file cannot be mapped
        self._file.flush()
        # Other processes of this user open the file by this process's descriptor.
        path = f'/proc/{os.getpid()}/fd/{self._file.fileno()}'
        self.location = RecordLocation(path, type(record), record.lengths())
        self.record: R = self.location.map()
