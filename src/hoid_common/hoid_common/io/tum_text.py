"""Text files of the TUM RGB-D layout: lines of a stamp in seconds and a text, `#` for comments."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.errors import InputError
from hoid_common.io.stamps import in_order, parse_stamp_ns
from hoid_common.io.untrusted import read_text
from hoid_common.values import FloatArray, IntArray

_LOG = logging.getLogger(__name__)


class Row(NamedTuple):
    """One line of a TUM text file."""

    line: int  # number of the line in the file, from 1
    stamp_ns: int
    text: str  # the rest of the line, in which spaces replace commas and tabs


class NumberTable(NamedTuple):
    """N stamped rows of numbers."""

    stamps_ns: IntArray  # (N,)
    values: FloatArray  # (N, columns)


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file; InputError if it is no text, or a stamp is no time in seconds."""
    for number, stamp, rest in _lines(path):
        try:
            yield Row(number, parse_stamp_ns(stamp), rest)
        except ValueError as error:
            raise InputError(f'{path}: line {number}: {error}') from error


def sorted_rows(path: Path) -> list[Row]:
    """Return the rows in order of time, each stamp once, with a warning if that was not so."""
    rows = list(read_rows(path))
    order = in_order([row.stamp_ns for row in rows])
    if text := str(order):
        _LOG.warning('%s: %s', path, text)
    return [rows[i] for i in order.positions.tolist()]


def read_numbers(
    path: Path,
    columns: int,
    problem: Callable[[FloatArray], str | None] = lambda _: None,
    *,
    is_finite: bool = True,
) -> NumberTable:
    """Return the stamp and the first `columns` numbers of each usable row, in order of time.

    Rows without stamp or numbers, or for which `problem` returns a text, are left out with a
    warning: motion-capture systems write rows of NaN or zeros while they do not see their target.
    InputError if there are rows, and none is usable.
    """
    stamps_ns: list[int] = []
    values: list[FloatArray] = []
    problems: list[str] = []
    for number, stamp, rest in _lines(path):
        try:
            stamp_ns, row = parse_stamp_ns(stamp), _numbers(rest, columns)
            if is_finite and not np.isfinite(row).all():
                raise ValueError(f'"{rest}" contains a number that is not finite')
            if text := problem(row):
                raise ValueError(text)
        except ValueError as error:
            problems.append(f'line {number}: {error}')
            continue
        stamps_ns.append(stamp_ns)
        values.append(row)
    if problems and not values:
        raise InputError(f'{path}: no row is usable; {problems[0]}')
    order = in_order(stamps_ns)
    left_out = f'{len(problems)} unusable rows left out ({problems[0]})' if problems else ''
    if text := ', '.join(filter(None, (left_out, str(order)))):
        _LOG.warning('%s: %s', path, text)
    return NumberTable(order.stamps_ns, np.array(values).reshape(-1, columns)[order.positions])


def _numbers(text: str, columns: int) -> FloatArray:
    words = text.split()[:columns]
    try:
        row = np.array([float(word) for word in words])
    except ValueError:
        row = np.empty(0)
    if len(row) < columns:
        raise ValueError(f'not {columns} numbers after the stamp: "{text}"')
    return row


def _lines(path: Path) -> Iterator[tuple[int, str, str]]:
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        stamp, _, rest = line.strip().replace(',', ' ').replace('\t', ' ').partition(' ')
        if stamp and not stamp.startswith('#'):
            yield number, stamp, rest.strip()
