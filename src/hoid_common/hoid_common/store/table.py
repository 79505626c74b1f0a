"""Tables of a map database, whose columns are numbers, texts and records of arrays."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.io.records import Column, Record

R = TypeVar('R', bound=Record)

_SQL_TYPES = {int: 'INTEGER', float: 'REAL', str: 'TEXT'}
_ALIGNMENT = 8  # bytes; each array begins at a multiple of it, as 64-bit numbers need
_NUMBER = np.dtype('<i8')


@dataclass(frozen=True)
class Table:
    """The declaration of a table, from which its SQL text follows.

    The name consists of lower-case letters and "_", and begins with the name of the package,
    except for tables of `rgbd_slam`. `key` is the first column, an integer. `columns` are int,
    float, str, or a type of `Record`. All columns are NOT NULL.
    """

    name: str
    key: str
    columns: Mapping[str, type]

    @property
    def sql(self) -> str:
        """Return the statement that creates the table, of the form of `checks.PLAIN_TABLE`."""
        columns = ''.join(
            f', {name} {_SQL_TYPES.get(kind, "BLOB")} NOT NULL'
            for name, kind in self.columns.items()
        )
        return f'CREATE TABLE {self.name} ({self.key} INTEGER PRIMARY KEY{columns}) STRICT'

    def packed(self, row: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(pack(value) if isinstance(value, Record) else value for value in row)

    def unpacked(self, row: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return a row whose bytes became read-only records; MapFileError if a type is wrong."""
        key, *values = row
        kinds = self.columns.items()
        return key, *(
            self._value(f'{self.name}.{name}', kind, value)
            for (name, kind), value in zip(kinds, values, strict=True)
        )

    def _value(self, place: str, kind: type[Any], value: Any) -> Any:
        expected = bytes if issubclass(kind, Record) else kind
        if not isinstance(value, expected):
            raise MapFileError(f'is damaged: {place} has a value of another type')
        try:
            return unpack(kind, value) if issubclass(kind, Record) else value
        except MapFileError as error:
            raise MapFileError(f'is damaged: {place}: {error}') from error


def pack(record: Record) -> bytes:
    """Return a record as bytes: checksum, lengths of its named axes, then its arrays in order."""
    lengths = record.lengths()
    parts = [np.array([lengths[axis] for axis in _axes(type(record))], _NUMBER).tobytes()]
    for name, array in record.arrays().items():
        data = np.asarray(array, record.columns()[name].dtype).tobytes()
        parts += [data, bytes(-len(data) % _ALIGNMENT)]
    return sealed(b''.join(parts))


def sealed(body: bytes) -> bytes:
    return zlib.crc32(body).to_bytes(_NUMBER.itemsize, 'little') + body


def unpack(kind: type[R], data: bytes) -> R:
    """Return the record that `pack` has packed, as read-only views; else MapFileError."""
    axes = _axes(kind)
    start = (1 + len(axes)) * _NUMBER.itemsize
    if len(data) < start:
        raise MapFileError('is shorter than its lengths')
    checksum, *counts = np.frombuffer(data, _NUMBER, 1 + len(axes)).tolist()
    if checksum != zlib.crc32(memoryview(data)[_NUMBER.itemsize :]):
        raise MapFileError('has another checksum')
    if not all(0 <= count <= len(data) for count in counts):
        raise MapFileError('declares a length that it does not have')
    lengths = dict(zip(axes, counts, strict=True))
    shapes = {name: column.shape(lengths) for name, column in kind.columns().items()}
    ends = list(_ends(kind.columns(), shapes, start))
    if (ends[-1] if ends else start) != len(data):
        raise MapFileError('has another size than its lengths declare')
    arrays = {}
    for (name, column), begin in zip(kind.columns().items(), [start, *ends], strict=False):
        count = math.prod(shapes[name])
        array = np.frombuffer(data, column.dtype, count, begin if count else 0)
        if column.dtype == np.bool_ and (array.view(np.uint8) > 1).any():
            raise MapFileError(f'{name} has Boolean values other than 0 and 1')
        arrays[name] = array.reshape(shapes[name])
    return kind(**arrays)


def _axes(kind: type[Record]) -> list[str]:
    axes = [axis for column in kind.columns().values() for axis in column.axes]
    return list(dict.fromkeys(axis for axis in axes if isinstance(axis, str)))


def _ends(
    columns: Mapping[str, Column], shapes: Mapping[str, tuple[int, ...]], start: int
) -> Iterator[int]:
    """Yield the offset of the end of each array and its padding; the first begins at `start`."""
    for name, column in columns.items():
        size = math.prod(shapes[name]) * column.dtype.itemsize
        start += size + -size % _ALIGNMENT
        yield start
