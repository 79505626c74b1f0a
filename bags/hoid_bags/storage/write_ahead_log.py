"""SQLite bags whose recorder was killed: their last messages are in the write-ahead log.

rosbags opens the file alone, so that it would miss the messages in the log.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import apsw

from hoid_common.errors import InputError


def has_log(path: Path) -> bool:
    """Return whether a .db3 file has a log (`<name>-wal`) beside it that is not empty."""
    log = _log(path)
    return log.is_file() and log.stat().st_size > 0


def with_log(path: Path, folder: Path) -> Path:
    """Copy a .db3 file into a folder, merge its log into the copy, and return the copy's path."""
    copy = folder / path.name
    try:
        shutil.copyfile(path, copy)
        shutil.copyfile(_log(path), _log(copy))
        connection = apsw.Connection(str(copy))
        connection.execute('PRAGMA journal_mode=DELETE').fetchall()  # writes the log into the file
        connection.close()
    except (OSError, apsw.Error) as error:
        raise InputError(
            f'{_log(path)}: the messages in this log cannot be read ({error}); open the bag once '
            f'with "sqlite3 {path} .tables", or move the log away to read the rest'
        ) from error
    return copy


def _log(path: Path) -> Path:
    return path.with_name(f'{path.name}-wal')
