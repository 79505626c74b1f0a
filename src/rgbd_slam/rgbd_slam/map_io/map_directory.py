"""Files that services may touch: names in one folder, nothing outside, each kind with its ending.

The one place that takes a name from whoever asks, and the one that writes such a file: aside, and
then renamed, so that what was there before is replaced by a complete file or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder, unwritable
from rgbd_slam.map_io.map_file import SUFFIX

T = TypeVar('T')

_MAX_BYTES = 200  # of a name: a file system takes 255, and what is written aside is called longer
_MAX_SHOWN = 40  # characters of a name that is refused
_MAX_ENDING = 8  # characters; "2024.05.17" has none


class FileKind(NamedTuple):
    """What is written for one service."""

    noun: str
    default: str  # name when none is given
    endings: tuple[str, ...]  # the first is put behind a name without one


MAP = FileKind('a map', 'map', (SUFFIX,))
TRAJECTORY = FileKind('a trajectory', 'trajectory', ('.txt', '.tum'))
CLOUD = FileKind('a cloud', 'cloud', ('.ply', '.pcd'))
GRID = FileKind('a grid', 'grid', ('.yaml', '.pgm'))


def path_in(directory: str, name: str, kind: FileKind) -> Path:
    """Return the path of a named file in the folder, which is made when missing.

    Args:
        directory: The folder; `~` is the home folder.
        name: A plain file name, with the kind's ending or without one; empty is the default.
        kind: What the file holds.

    Raises:
        InputError: The name would or might lead out of the folder, no file can have it, or it is
            that of another kind of file; or the folder cannot be made.
    """
    _check_name(name, directory)
    file_name = _with_ending(name or kind.default, kind)
    if len(file_name.encode()) > _MAX_BYTES:
        raise InputError(f'"{shown(name)}" is too long a name: {_MAX_BYTES} bytes at most')
    folder = Path(directory).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder}: cannot be made: {error.strerror}') from error
    path = folder / file_name
    if path.is_symlink():
        raise InputError(f'{path} is a link, and may lead out of the folder; use another name')
    return path


def write_whole(path: Path, write: Callable[[Path], T]) -> T:
    """Have files written into a folder aside, and move them beside `path` when all are there.

    Returns what `write` does.

    Args:
        path: Of the file that matters; the others go where it goes.
        write: Gets the path to write instead; what lies beside that is moved as well.

    Raises:
        InputError: They cannot be written; what was there before still is.
    """
    try:
        with scratch_folder(path.parent, 'partial') as aside:
            done = write(aside / path.name)
            for file in sorted(aside.iterdir()):
                file.replace(path.parent / file.name)
    except OSError as error:
        raise unwritable(path, error) from error
    return done


def _check_name(name: str, directory: str) -> None:
    # What is not printable could not be typed again, nor said in a line; a dot would hide it.
    if not name.isprintable() or name.startswith('.') or '/' in name:
        raise InputError(
            f'"{shown(name)}" is no plain file name; files lie in {directory} and not outside'
        )


def _with_ending(name: str, kind: FileKind) -> str:
    """Return the name with an ending of the kind; a word after a dot is an ending, a date not."""
    ending = Path(name).suffix
    if ending in kind.endings:
        return name
    if ending[1:].isalpha() and len(ending) <= _MAX_ENDING + 1:
        raise InputError(f'"{shown(name)}": {kind.noun} ends in {" or ".join(kind.endings)}')
    return name + kind.endings[0]


def shown(name: str) -> str:
    """Return what of a text that somebody sent may stand in a line."""
    said = ''.join(c if c.isprintable() else '?' for c in name[:_MAX_SHOWN])
    return said + '...' * (len(name) > _MAX_SHOWN)
