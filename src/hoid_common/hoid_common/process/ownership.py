"""The owner of a store of maps: the one process that may write it."""

from __future__ import annotations

import fcntl
import os
import socket
from contextlib import suppress
from pathlib import Path

from hoid_common.errors import InputError

_MAX_BYTES = 500  # chosen: more than the text of an owner has


class Ownership:
    """Makes this process the only owner of a store, until `close` or until the process ends.

    The kernel releases the lock (flock) when the process ends in whatever way. Nothing is locked
    if the lock file cannot be opened, or if its file system has no locks.

    Args:
        path: The lock file. It is made if it is missing, and stays when the process ends.

    Raises:
        InputError: Another process owns the store; the text says which one, and where it runs.
    """

    def __init__(self, path: Path, name: str) -> None:
        self._descriptor: int | None = None
        with suppress(OSError):  # the store cannot be written either, which its writer reports
            path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            self._lock(self._descriptor, path.parent, name)

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _lock(self, descriptor: int, folder: Path, name: str) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(descriptor, _MAX_BYTES, 0).decode(errors='replace').strip()
            self.close()
            raise InputError(
                f'another {name} runs already: {owner or "its process is just starting"}; it '
                f'stores its map in {folder}. End it, or give this node another namespace, '
                'ROS_DOMAIN_ID or map_directory'
            ) from None
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f'process {os.getpid()} on {socket.gethostname()}\n'.encode(), 0)
