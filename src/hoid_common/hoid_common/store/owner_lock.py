"""A lock that says which process owns a database; it ends with its process, however that ends."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from pathlib import Path
from typing import Self

from hoid_common.errors import MapFileError

_MAX_SHOWN = 200  # characters of the owner's description that an error quotes


class OwnerLock:
    """The only owner of a database, until `release` or the end of the process.

    The lock is on a file of its own, because SQLite locks the database itself for each access. On
    a file system without locks, everybody owns the database.

    Args:
        owner: Who takes the lock, such as the full name of a node; the error names it to others.

    Raises:
        MapFileError: Another process or object has the lock, or the file cannot be made.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise MapFileError(f'{path}: cannot be written: {error.strerror}') from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                other = os.read(self._descriptor, _MAX_SHOWN).decode(errors='replace')
                self.release()
                raise MapFileError(
                    f'{path.parent}: {owner} already runs here, as {other or "another process"}: '
                    'end that one first, or use another namespace or folder of maps'
                ) from error
        text = f'{owner}, process {os.getpid()} on {socket.gethostname()}'
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, text.encode(), 0)

    def release(self) -> None:
        """Release the lock, if it is held."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Self:
        """Return the lock, which is released at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self.release()
