"""Reading of the text files of the TUM RGB-D layout.

Each line is a stamp in seconds and a text, separated by spaces, tabs or commas; `#` starts a
comment.
"""

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

    line: int  # number of the line in the file, from 1
    stamp_ns: int
    text: str  # the rest of the line


class NumberTable(NamedTuple):
    """N stamped rows of numbers."""

    stamps_ns: IntArray  # (N,)
    values: FloatArray  # (N, columns)


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file, in the file's order.

    Raises:
        InputError: The file is missing or no text, or a stamp is no time in seconds.
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


def without_duplicates(rows: list[Row]) -> list[Row]:
    """Return the rows without those that equal their predecessor, which some tools write."""
    return rows[:1] + [
        row
        for before, row in pairwise(rows)
        if (row.stamp_ns, row.text) != (before.stamp_ns, before.text)
    ]


def check_increasing(path: Path, rows: list[Row]) -> None:
    """Raise InputError for the first stamp that is not later than its predecessor."""
    for before, row in pairwise(rows):
        if row.stamp_ns <= before.stamp_ns:
            raise InputError(
                f'{path}: line {row.line}: stamp {row.stamp_ns} ns is not after the one before it'
                f' ({before.stamp_ns} ns); sort the file by time'
            )


def read_numbers(path: Path, columns: int) -> NumberTable:
    """Return the first `columns` numbers of each row of a file, in order of time.

    Raises:
        InputError: As in `read_rows`; or a row has too few numbers or one that is not finite, or
            goes back in time.
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
                f'{path}: line {row.line}: "{row.text}" contains a number that is not finite'
            )
    return NumberTable(np.array([row.stamp_ns for row in rows], np.int64), values)
