"""Checks of a map file, so that a hostile file cannot harm the program."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.errors import InputError, MapFileError, prefixed
from hoid_common.io.untrusted import open_regular
from hoid_common.store.table import Table
from hoid_common.values import FloatArray

MAX_POSITION_M = 1e5  # chosen: no map is larger, and squares of positions keep their precision
MAX_COUNT = 2**40  # chosen: no sum of two counts overflows
# Chosen: range of weights, so that no product with a color or a coordinate overflows.
MIN_WEIGHT, MAX_WEIGHT = 1e-30, 1e30
APPLICATION_ID = int.from_bytes(b'hoid', 'big')
VERSION = 2  # of all tables together; a change of any table adds one
# The form of every table's SQL text (`Table.sql`): it contains no expression, so that reading,
# writing or checking rows never executes SQL of the file.
PLAIN_TABLE = re.compile(
    r'CREATE TABLE ([a-z_]+) \([a-z_]+ INTEGER PRIMARY KEY'
    r'(?:, [A-Za-z_0-9]+ (?:INTEGER|REAL|TEXT|BLOB) NOT NULL)*\) STRICT'
)
_HEADER_BYTES = 100
_SQLITE, _ZIP = b'SQLite format 3\0', b'PK\x03\x04'
_MAX_QUOTED = 80  # number of characters that an error quotes of a text in the file


def require(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise MapFileError(otherwise)


def within(values: NDArray[Any], low: float, end: float) -> bool:
    """Return whether all values are in [low, end): True without values, False if one is NaN."""
    return values.size == 0 or bool(values.min() >= low and values.max() < end)


def are_poses(T: FloatArray) -> bool:
    """Return whether all T (N, 4, 4) are rigid, with positions in the range of a map."""
    return bool((se3.is_rigid(T) & (np.abs(T) < MAX_POSITION_M).all((1, 2))).all())


def check_header(path: Path) -> None:
    """Check without SQLite that a file is a map of this version, else raise MapFileError."""
    with (
        prefixed('', MapFileError, InputError),
        prefixed(f'{path}: cannot be read: ', MapFileError, OSError),
        open_regular(path) as file,
    ):
        header = file.read(_HEADER_BYTES)
    if header.startswith(_ZIP):
        raise MapFileError(
            f'{path}: is a map of version 0.3 or earlier, which this version does not read: map '
            'the place anew, or use version 0.3'
        )
    version, application = header[60:64], header[68:72]
    if not header.startswith(_SQLITE) or int.from_bytes(application, 'big') != APPLICATION_ID:
        raise MapFileError(f'{path}: is no map file')
    if int.from_bytes(version, 'big') != VERSION:
        raise MapFileError(
            f'{path}: is of version {int.from_bytes(version, "big")}, and this program reads '
            f'version {VERSION}: use the program that made it, or map the place anew'
        )


def check_content(connection: sqlite3.Connection, tables: Sequence[Table]) -> frozenset[str]:
    """Check the schema of a database, then all its pages; return the names of its tables.

    MapFileError, which does not name the file, if the schema has anything but plain tables, if one
    of `tables` has other columns, or if a page is damaged.
    """
    known, found = {table.name: table.sql for table in tables}, set()
    for kind, name, sql in connection.execute('SELECT type, name, sql FROM sqlite_schema'):
        match = PLAIN_TABLE.fullmatch(sql) if isinstance(sql, str) else None
        if kind != 'table' or match is None or match[1] != name:
            raise MapFileError(f'has a foreign part: {kind!r:.20} {name!r:.{_MAX_QUOTED}}')
        if known.get(name, sql) != sql:
            raise MapFileError(f'is of another version of this program: its {name} differ')
        found.add(name)
    ((result,),) = connection.execute('PRAGMA quick_check(1)').fetchall()
    if result != 'ok':
        raise MapFileError(f'is damaged: {" ".join(str(result).split())[:_MAX_QUOTED]}')
    return frozenset(found)
