"""Records: frozen dataclasses of parallel arrays, whose types and shapes are declared once."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Self, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Column(NamedTuple):
    """Type and shape of an array field of a `Record`."""

    dtype: np.dtype[Any]  # little-endian
    axes: tuple[str | int, ...]  # each a fixed length or the name of a length

    def shape(self, lengths: Mapping[str, int]) -> tuple[int, ...]:
        return tuple(axis if isinstance(axis, int) else lengths[axis] for axis in self.axes)


def column(dtype: str, *axes: str | int) -> Column:
    """Return the column of a NumPy type ('f4'); each axis is a length or the name of one."""
    return Column(np.dtype(dtype).newbyteorder('<'), axes)


@dataclass(frozen=True, eq=False)
class Record:
    """Arrays with declared types and shapes; a field is `name: Annotated[type, column(...)]`."""

    @classmethod
    @cache
    def columns(cls) -> Mapping[str, Column]:
        hints = get_type_hints(cls, include_extras=True)
        return {name: get_args(hint)[1] for name, hint in hints.items()}

    @classmethod
    def of(cls, arrays: Mapping[str, Array]) -> Self:
        """Return the record of arrays given by field name; KeyError if one is missing."""
        return cls(
            **{
                name: np.ascontiguousarray(arrays[name], column.dtype)
                for name, column in cls.columns().items()
            }
        )

    def arrays(self) -> dict[str, Array]:
        return {name: getattr(self, name) for name in self.columns()}

    def lengths(self) -> dict[str, int]:
        return {
            axis: length
            for name, column in self.columns().items()
            for axis, length in zip(column.axes, getattr(self, name).shape, strict=True)
            if isinstance(axis, str)
        }

    def digest(self) -> str:
        """Return the SHA-256 of all names, shapes and values, in hexadecimal."""
        sha = hashlib.sha256()
        for name, array in self.arrays().items():
            sha.update(f'{name}{array.shape}'.encode())
            sha.update(np.ascontiguousarray(array).data)
        return sha.hexdigest()
