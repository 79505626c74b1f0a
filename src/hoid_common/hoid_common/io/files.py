"""Files and folders that are written: refused in one line, and never left half done."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hoid_common.errors import InputError


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
        folder = Path(tempfile.mkdtemp(prefix=f'.{purpose}-', dir=within))
    except OSError as error:
        raise unwritable(within, error) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if not was_there:
            with suppress(OSError):  # not empty, which is usual
                within.rmdir()


def check_writable(folder: Path) -> None:
    """Raise InputError if no results could be written there: before the work, not after it."""
    with scratch_folder(folder, 'check'):
        pass
