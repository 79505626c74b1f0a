"""Files and folders that are written: refused in one line, and never left half done."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hoid_common.errors import InputError

_PARTIAL = '.partial-'  # in the name of every scratch folder


def unwritable(path: Path, error: OSError) -> InputError:
    """Return the error to raise for a file or folder that the system refuses to write."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return InputError(f'{path}: cannot be written: part of this path is a file, not a folder')
    return InputError(f'{path}: cannot be written: {error.strerror or error}')


@contextmanager
def scratch_folder(within: Path, purpose: str) -> Iterator[Path]:
    """Give a hidden folder that goes away with all that is in it when the block ends.

    Args:
        within: Where it is made, so that files can be moved out of it without copying; made when
            missing, and then removed again if nothing else came into it.
        purpose: A word for its name, by which people know what was left behind by a power cut.

    Raises:
        InputError: Nothing can be written there.
    """
    was_there = within.exists()
    try:
        within.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f'.{purpose}{_PARTIAL}', dir=within))
    except OSError as error:
        raise unwritable(within, error) from error
    try:
        with _held(folder):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if not was_there:
            with suppress(OSError):  # not empty, which is usual
                within.rmdir()


def leftovers(within: Path) -> list[Path]:
    """Return the scratch folders of processes that were killed, in order of their names."""
    with suppress(OSError):  # not there, not readable
        return sorted(path for path in within.glob(f'.*{_PARTIAL}*') if _is_left(path))
    return []


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Lock a folder, which tells others that it is in use; the lock ends with the process."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _is_left(folder: Path) -> bool:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:  # gone by now, or no folder
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # in use
        return False
    finally:
        os.close(descriptor)
    return True


def check_writable(folder: Path) -> None:
    """Raise InputError if no results could be written there: before the work, not after it."""
    with scratch_folder(folder, 'check'):
        pass
