"""Atomic writing of files and folders by way of scratch folders, and errors of writing."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hoid_common.errors import InputError

_PARTIAL = '.partial-'  # part of the name of every scratch folder


def write_error(path: Path, error: OSError) -> InputError:
    if isinstance(error, FileExistsError | NotADirectoryError):
        return InputError(f'{path}: cannot be written: part of this path is a file, not a folder')
    return InputError(f'{path}: cannot be written: {error.strerror or error}')


@contextmanager
def written(path: Path) -> Iterator[None]:
    """Raise InputError, which names `path`, in place of an OSError."""
    try:
        yield
    except OSError as error:
        raise write_error(path, error) from error


@contextmanager
def scratch_folder(within: Path, purpose: str) -> Iterator[Path]:
    """Yield a new hidden folder, which is removed with its content at the end of the block.

    The caller writes results there and moves them when they are complete, so that a reader never
    finds half a file. `within` must be on the same file system, and is created if missing.
    `purpose` is part of the name, to identify the folder after a power cut. InputError: the folder
    cannot be created.
    """
    with ExitStack() as stack:
        with written(within):
            stack.enter_context(_made(within))
            folder = Path(tempfile.mkdtemp(prefix=f'.{purpose}{_PARTIAL}', dir=within))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        stack.enter_context(_locked(folder))
        yield folder


@contextmanager
def staged(folder: Path, target: Path | None = None) -> Iterator[Path]:
    """Yield a scratch folder, whose files are moved to `folder` at the end of the block.

    If the block raises an error, `folder` stays unchanged. InputError, which names `target` (by
    default `folder`), if the files cannot be written.
    """
    with written(target or folder), scratch_folder(folder, 'results') as stage:
        yield stage
        for path in sorted(stage.iterdir()):
            path.replace(folder / path.name)


def write_file(path: Path, data: bytes) -> None:
    """Write a file, and create its folder if it is missing; InputError if this fails."""
    with written(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Create a missing folder with its parents; remove those that are empty at the end."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with suppress(OSError):  # it is not empty, since the results are there
            for path in missing:
                path.rmdir()


def abandoned_scratch_folders(within: Path) -> list[Path]:
    """Return the scratch folders of killed processes; none on a file system without locks."""
    with suppress(OSError):  # `within` is missing or not readable
        return sorted(path for path in within.glob(f'.*{_PARTIAL}*') if _is_abandoned(path))
    return []


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # the file system has no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _is_abandoned(folder: Path) -> bool:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:  # it was removed in the meantime, or is no folder
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # a running process holds the lock, or the file system has no locks
        return False
    finally:
        os.close(descriptor)
    return True


def check_writable(folder: Path) -> None:
    """Raise InputError if no file can be written to a folder. The folder need not exist."""
    with scratch_folder(folder, 'check'):
        pass
