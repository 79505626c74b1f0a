"""The text files of the TUM RGB-D layout: one stamped row per line, `#` starts a comment."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.errors import InputError
from hoid_common.io.stamps import parse_stamp_ns
from hoid_common.io.untrusted import read_text
from hoid_common.values import FloatArray, IntArray


class Row(NamedTuple):
    """One line of a TUM text file."""

    line: int  # counted from 1
    stamp_ns: int
    text: str  # what follows the stamp


class NumberTable(NamedTuple):
    """Stamped rows of numbers."""

    stamps_ns: IntArray  # (N,)
    values: FloatArray  # (N, columns)


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file in its order.

    Raises:
        InputError: the file is missing or not text, or a stamp is not a time in seconds.
    """
    text = read_text(path)
    for number, line in enumerate(text.splitlines(), start=1):
        stamp, _, rest = line.strip().replace(',', ' ').replace('\t', ' ').partition(' ')
        if not stamp or stamp.startswith('#'):
            continue
        try:
            stamp_ns = parse_stamp_ns(stamp)
        except ValueError as error:
            raise InputError(f'{path}: line {number}: {error}') from error
        yield Row(number, stamp_ns, rest.strip())


def without_repeats(rows: list[Row]) -> list[Row]:
    """Return the rows less those that say the same as the one before; some tools write such."""
    return rows[:1] + [
        row
        for before, row in pairwise(rows)
        if (row.stamp_ns, row.text) != (before.stamp_ns, before.text)
    ]


def check_increasing(path: Path, rows: list[Row]) -> None:
    """Raise InputError at the first stamp that is not later than the one before it."""
    for before, row in pairwise(rows):
        if row.stamp_ns <= before.stamp_ns:
            raise InputError(
                f'{path}: line {row.line}: stamp {row.stamp_ns} ns is not after the one before it'
                f' ({before.stamp_ns} ns); bring the list into order of time'
            )


def read_numbers(path: Path, columns: int) -> NumberTable:
    """Return the rows of a file of numbers, in order of time.

    Raises:
        InputError: as `read_rows`, or a row has too few or no finite numbers or goes back in time.
    """
    rows = list(read_rows(path))
    check_increasing(path, rows)
    values = np.empty((len(rows), columns))
    for i, row in enumerate(rows):
        try:
            values[i] = [float(word) for word in row.text.split()[:columns]]
        except ValueError as error:
            raise InputError(
                f'{path}: line {row.line}: not {columns} numbers after the stamp: "{row.text}"'
            ) from error
        if not np.isfinite(values[i]).all():
            raise InputError(
                f'{path}: line {row.line}: "{row.text}" holds a number that is not finite'
            )
    return NumberTable(np.array([row.stamp_ns for row in rows], np.int64), values)
