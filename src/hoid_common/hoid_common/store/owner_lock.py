"""A lock that says which process owns a database; it ends with its process, however that ends."""

from __future__ import annotations

import fcntl
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import Self

from hoid_common.errors import MapFileError

_MAX_BYTES = 500  # chosen: more than the text of an owner has


class OwnerLock:
    """Makes this process the only owner of a database, until `release` or until it ends.

    The lock is on a file of its own, which stays, because SQLite locks the database itself for
    each access. The kernel releases it when the process ends. Nothing is locked if the file cannot
    be opened, or if its file system has no locks. MapFileError if another process owns the
    database; `owner` is the full name of the node.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self._descriptor: int | None = None
        with suppress(OSError):  # the database cannot be written either, which its writer reports
            path.parent.mkdir(parents=True, exist_ok=True)
            # Only read, so that the disk can be made read-only meanwhile.
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
