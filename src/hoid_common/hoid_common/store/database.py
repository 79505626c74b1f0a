"""A map as an SQLite database: created, opened by its only owner, or checked and read.

A database in use (`start`) is in WAL mode, so that the file has each transaction completely or not
at all, whenever a process or computer dies. A finished database is a single file.
"""

from __future__ import annotations

import fcntl
import os
import socket
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from hoid_common.errors import MapFileError, prefixed
from hoid_common.io.files import scratch_folder
from hoid_common.store.checks import APPLICATION_ID, VERSION, check_content, check_header
from hoid_common.store.table import Table

SUFFIX = '.hoidmap'
_PAGE_BYTES = 16_384  # measured in a trial: fastest for blobs of 50 kB
# Chosen: a larger journal is truncated once its content is in the database file.
_JOURNAL_BYTES = 32_000_000
_PATIENCE_S = 10.0  # chosen: how long a statement waits for the transaction of another process
_SIDE_FILES = ('-wal', '-shm', '-journal')
_REMEDIES = {
    'SQLITE_FULL': 'cannot be written: the disk is full; free space on it',
    'SQLITE_READONLY': 'cannot be written: the file or its folder is read-only',
    'SQLITE_CANTOPEN': 'cannot be opened: is its folder missing, or not accessible?',
    'SQLITE_BUSY': 'is in use by another process; try again',
    'SQLITE_LOCKED': 'is in use by another process; try again',
    'SQLITE_PERM': 'cannot be opened: permission denied',
    'SQLITE_NOMEM': 'does not fit into memory',
    'SQLITE_TOOBIG': 'is damaged: a value is larger than the file',
}
_MAX_BYTES = 500  # chosen: more than the length of the text that names an owner


class Database:
    """An open database. Any thread may use it, but only one at a time.

    Every method raises MapFileError, a line that names the file, if the database cannot be read or
    written or is damaged.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection

    @classmethod
    def create(cls, path: Path, tables: Iterable[Table]) -> Self:
        """Create a database with empty tables in a new file.

        The database has no journal: if the process is killed, the file is useless. `replaced` or
        `start` renames it to its final name once it is complete.
        """
        with prefixed(f'{path}: cannot be written: ', MapFileError, OSError):
            path.touch(exist_ok=False)
        with _connected(path, 'rw') as connection:
            connection.execute(f'PRAGMA page_size = {_PAGE_BYTES}')
            connection.execute('PRAGMA journal_mode = OFF')
            connection.execute('PRAGMA synchronous = OFF')
            connection.execute(f'PRAGMA application_id = {APPLICATION_ID}')
            connection.execute(f'PRAGMA user_version = {VERSION}')
            for table in tables:
                connection.execute(table.sql)
            return cls(path, connection)

    @classmethod
    def start(cls, path: Path, tables: Iterable[Table]) -> Self:
        """Create a database with empty tables in a new file, whose transactions survive a kill."""
        tables = tuple(tables)
        if path.exists():
            raise MapFileError(f'{path}: exists already')
        for side in side_files(path):
            # SQLite would take old journal files for those of the new database.
            with suppress(OSError):
                side.unlink()
        with replaced(path) as aside:
            cls.create(aside, tables).close()
        with _connected(path, 'rw') as connection:
            connection.execute('PRAGMA journal_mode = WAL')
            return cls(path, connection)

    @classmethod
    def open(cls, path: Path, tables: Iterable[Table], *, is_own: bool = False) -> Self:
        """Open an existing database to read and write it, after the checks of `read`.

        Missing tables are added, and the journal of a killed process is applied. If this process
        has written the file (`is_own`), only its header is checked.
        """
        check_header(path)
        tables = tuple(tables)
        with _connected(path, 'rw') as connection:
            found = frozenset(table.name for table in tables)
            if not is_own:
                found = check_content(connection, tables)
            for table in tables:
                if table.name not in found:
                    connection.execute(table.sql)
            return cls(path, connection)

    @classmethod
    def read(cls, path: Path, tables: Iterable[Table]) -> Self:
        """Open a database only to read it, after checking its schema and its pages."""
        check_header(path)
        # A database that no process uses is opened as immutable, thus without locks, so that its
        # folder may be read-only.
        is_in_use = path.with_name(path.name + '-wal').exists()
        with _connected(path, 'ro' if is_in_use else 'ro&immutable=1') as connection:
            connection.execute('PRAGMA query_only = ON')
            check_content(connection, tuple(tables))
            return cls(path, connection)

    def close(self) -> None:
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit all writes of the block at its end, or none if the block raises. Do not nest."""
        self.begin()
        try:
            yield
            self.commit()
        except BaseException:
            self.rollback()
            raise

    def begin(self) -> None:
        self._run('BEGIN IMMEDIATE')

    def commit(self) -> None:
        """Write all changes since `begin` to the file; call `rollback` if that fails."""
        self._run('COMMIT')

    def rollback(self) -> None:
        with suppress(sqlite3.Error):  # SQLite may have ended the transaction itself
            self._connection.execute('ROLLBACK')

    def put(self, table: Table, rows: Iterable[tuple[Any, ...]]) -> None:
        """Insert rows (key, other columns...); a row with an existing key replaces the old one."""
        places = ', '.join('?' * (1 + len(table.columns)))
        with _described(self.path):
            self._connection.executemany(
                f'INSERT OR REPLACE INTO {table.name} VALUES ({places})',  # noqa: S608
                map(table.packed, rows),
            )

    def delete(self, table: Table, keys: Iterable[int]) -> None:
        with _described(self.path):
            self._connection.executemany(
                f'DELETE FROM {table.name} WHERE {table.key} = ?',  # noqa: S608
                ((key,) for key in keys),
            )

    def clear(self, table: Table) -> None:
        self._run(f'DELETE FROM {table.name}')  # noqa: S608

    def rows(self, table: Table) -> Iterator[tuple[Any, ...]]:
        """Yield all rows (key, other columns...) by ascending key."""
        columns = ', '.join((table.key, *table.columns))
        with _described(self.path), closing(self._connection.cursor()) as cursor:
            cursor.execute(f'SELECT {columns} FROM {table.name} ORDER BY {table.key}')  # noqa: S608
            for row in cursor:
                yield table.unpacked(row)

    def row(self, table: Table, key: int) -> tuple[Any, ...] | None:
        columns = ', '.join((table.key, *table.columns))
        sql = f'SELECT {columns} FROM {table.name} WHERE {table.key} = ?'  # noqa: S608
        with _described(self.path):
            row = self._connection.execute(sql, (key,)).fetchone()
            return None if row is None else table.unpacked(row)

    def count(self, table: Table) -> int:
        return int(self._run(f'SELECT count(*) FROM {table.name}')[0][0])  # noqa: S608

    def has(self, table: Table) -> bool:
        sql = f"SELECT 1 FROM sqlite_schema WHERE name = '{table.name}'"  # noqa: S608
        return bool(self._run(sql))

    def copy_to(self, path: Path) -> None:
        """Copy the content to a new single file by SQLite's backup, without syncing the disk."""
        with _described(path), closing(sqlite3.connect(path)) as copy:
            copy.execute('PRAGMA journal_mode = OFF')
            copy.execute('PRAGMA synchronous = OFF')
            self._connection.backup(copy)
            copy.execute('PRAGMA journal_mode = DELETE')

    def finish(self) -> None:
        """Close the database as a single finished file; fails while another process reads it."""
        self._run('PRAGMA journal_mode = DELETE')
        self.close()

    def _run(self, sql: str) -> list[Any]:
        with _described(self.path):
            return self._connection.execute(sql).fetchall()


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield the path of a new file, which replaces `path` at the end of the block.

    It is renamed only after all its bytes are on disk, and not if the block raises.
    `abandoned_scratch_folders` finds the files that a killed process leaves.
    """
    with scratch_folder(path.parent, 'map') as folder:
        aside = folder / path.name
        try:
            yield aside
        except MapFileError as error:
            raise MapFileError(str(error).replace(str(aside), str(path))) from error
        with prefixed(f'{path}: cannot be written: ', MapFileError, OSError):
            with aside.open('rb') as file:
                os.fsync(file.fileno())
            aside.replace(path)
            _sync_folder(path.parent)


def kept(path: Path, name: Path) -> Path:
    """Rename an unused database with its journal; append -2, -3 ... if the name is taken."""
    new, number = name, 1
    with prefixed(f'{path}: cannot be renamed: ', MapFileError, OSError):
        while not _is_reserved(new):
            number += 1
            new = name.with_name(f'{name.stem}-{number}{name.suffix}')
        for old, side in zip(side_files(path), side_files(new), strict=True):
            with suppress(FileNotFoundError):
                old.rename(side)
        path.replace(new)
        _sync_folder(path.parent)
    return new


def side_files(path: Path) -> Sequence[Path]:
    return [path.with_name(path.name + end) for end in _SIDE_FILES]


def _is_reserved(path: Path) -> bool:
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def _connected(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """Yield a connection in SQLite's access `mode`; it is closed if the block raises."""
    with _described(path), ExitStack() as stack:
        connection = sqlite3.connect(
            f'{path.absolute().as_uri()}?mode={mode}',
            uri=True,
            timeout=_PATIENCE_S,
            isolation_level=None,
            check_same_thread=False,
        )
        stack.callback(connection.close)
        # No SQL text in the file may be executed.
        connection.execute('PRAGMA trusted_schema = OFF')
        connection.execute('PRAGMA cell_size_check = ON')
        connection.execute('PRAGMA temp_store = MEMORY')
        connection.execute('PRAGMA synchronous = NORMAL')
        connection.execute(f'PRAGMA journal_size_limit = {_JOURNAL_BYTES}')
        if mode != 'rw':  # no value is larger than the file
            limit = _size(path) + _size(path.with_name(path.name + '-wal'))
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(limit, _PAGE_BYTES))
        yield connection
        stack.pop_all()


def _size(path: Path) -> int:
    with suppress(OSError):
        return path.stat().st_size
    return 0


@contextmanager
def _described(path: Path) -> Iterator[None]:
    try:
        yield
    except MapFileError as error:
        text = str(error)
        raise error if text.startswith(f'{path}: ') else MapFileError(f'{path}: {text}') from error
    except MemoryError as error:
        raise MapFileError(f'{path}: does not fit into memory') from error
    except sqlite3.Error as error:
        name = getattr(error, 'sqlite_errorname', '')
        remedy = next((text for code, text in _REMEDIES.items() if name.startswith(code)), None)
        if remedy is None and name.startswith('SQLITE_IOERR'):
            remedy = f'cannot be read or written ({name[7:]}): check the disk and its free space'
        raise MapFileError(f'{path}: {remedy or f"is damaged: {error}"}') from error


class OwnerLock:
    """Makes this process the only owner of a database, until `release` or its end.

    The lock is on a separate permanent file, because SQLite locks the database file itself for
    each access. The kernel releases the lock when the process ends. Nothing is locked if the lock
    file cannot be opened, or if its file system has no locks. MapFileError if another process owns
    the database; `owner` is the full name of the node.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self._descriptor: int | None = None
        # If this fails, the database cannot be written either, which its writer reports.
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            # Opened only for reading, so that the disk can become read-only meanwhile.
            flags = os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC
            self._descriptor = os.open(path, flags, 0o644)
            self._lock(self._descriptor, path.parent, owner)
            path.write_text(f'process {os.getpid()} on {socket.gethostname()}\n')

    def release(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _lock(self, descriptor: int, folder: Path, owner: str) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = os.pread(descriptor, _MAX_BYTES, 0).decode(errors='replace').strip()
            self.release()
            raise MapFileError(
                f'another {owner} runs already: {other or "its process is just starting"}; it '
                f'stores its map in {folder}. End it, or give this node another namespace, '
                'ROS_DOMAIN_ID or map_directory'
            ) from None
