"""The temporary folder with the files of the stored images."""

from __future__ import annotations

import fcntl
import os
import shutil
import weakref
from contextlib import suppress
from pathlib import Path
from tempfile import gettempdir, mkdtemp

_PREFIX = 'hoid-scene-'
_LOCK = 'lock'


class ViewFolder:
    """A folder below the system's folder for temporary files, which TMPDIR names.

    It is removed with this object, or when the process ends. The folder of a process that was
    killed is removed when the next one is created: nobody holds the lock on its lock file.
    """

    def __init__(self) -> None:
        _remove_abandoned()
        self.path = Path(mkdtemp(prefix=_PREFIX))
        lock = os.open(self.path / _LOCK, os.O_CREAT | os.O_RDWR)
        fcntl.flock(lock, fcntl.LOCK_EX)
        self._remove = weakref.finalize(self, _remove, self.path, lock)

    def close(self) -> None:
        """Remove the folder with its files."""
        self._remove()


def _remove(path: Path, lock: int) -> None:
    shutil.rmtree(path, ignore_errors=True)
    os.close(lock)


def _remove_abandoned() -> None:
    for lock in Path(gettempdir()).glob(f'{_PREFIX}*/{_LOCK}'):
        with suppress(OSError), lock.open('rb') as file:  # OSError: it is in use
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.parent, ignore_errors=True)
