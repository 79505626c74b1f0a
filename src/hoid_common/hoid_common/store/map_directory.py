"""Paths of the files that service requests name: plain names in one folder are accepted."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

from hoid_common.errors import InputError, prefixed
from hoid_common.io.files import abandoned_scratch_folders, staged
from hoid_common.io.untrusted import expand_home
from hoid_common.store.database import SUFFIX

T = TypeVar('T')

# Largest number of bytes of a file name. A file system allows 255 bytes, and the names of scratch
# files, which contain this name, are longer.
_MAX_BYTES = 200
_MIN_AGE_S = 60.0  # chosen: many times the time between the creation of a file and its lock
_MAX_PRINTED = 40  # chosen: characters of a refused name in an error message
_MAX_ENDING = 8  # chosen: a longer word after a dot does not count as an ending


class FileKind(NamedTuple):
    """A kind of file that a service writes or reads."""

    noun: str  # such as "a map"; used in error texts
    default: str  # name if the request has none
    endings: tuple[str, ...]  # the first one is appended to a name without an ending


MAP = FileKind('a map', 'map', (SUFFIX,))
TRAJECTORY = FileKind('a trajectory', 'trajectory', ('.txt', '.tum'))
CLOUD = FileKind('a cloud', 'cloud', ('.ply',))
OBJECTS = FileKind('a list of objects', 'objects', ('.yaml',))
GRID = FileKind('a grid', 'grid', ('.yaml', '.pgm'))


def path_in(directory: str, name: str, kind: FileKind) -> Path:
    """Return the path of a named file in the map folder, which is created if it is missing.

    `~` is the home folder; an empty name means `kind.default`. InputError if the name is not a
    plain file name, has another kind's ending, or belongs to a link, or if the folder cannot be
    created.
    """
    _check_name(name, directory)
    file_name = _with_ending(name or kind.default, kind)
    if len(file_name.encode()) > _MAX_BYTES:
        raise InputError(f'"{printable(name)}" is too long a name: {_MAX_BYTES} bytes at most')
    folder = expand_home(directory, 'map_directory')
    with prefixed(f'{folder}: cannot be created: ', InputError, OSError):
        folder.mkdir(parents=True, exist_ok=True)
    path = folder / file_name
    if path.is_symlink():
        raise InputError(f'{path} is a link that may lead out of the folder; use another name')
    return path


def existing_map(directory: str, name: str) -> Path:
    """Return the path of a saved map; InputError, which lists the maps, if it does not exist."""
    path = path_in(directory, name, MAP)
    if not path.exists():
        raise InputError(f'{path}: there is no such file; {_maps_in(path.parent)}')
    return path


def named_map(path: Path) -> Path:
    if path.is_dir() and path.suffix != SUFFIX:
        raise InputError(f'{path}: is a folder, and no map; {_maps_in(path)}')
    return path


def _maps_in(folder: Path) -> str:
    names = sorted(path.stem for path in folder.glob(f'[!.]*{SUFFIX}'))
    return f'the maps in the folder are {", ".join(names)}' if names else 'the folder has no map'


def write_whole(path: Path, write: Callable[[Path], T]) -> T:
    """Call `write`, and replace each existing file by a complete new one or not at all.

    `write` gets a path in a scratch folder for the main file. Files that it writes beside that
    path are moved as well. Return the result of `write`. InputError if a file cannot be written.
    """
    with staged(path.parent, path) as aside:
        return write(aside / path.name)


def remove_abandoned(directory: str) -> list[str]:
    """Remove unfinished files of killed processes; return the removed names.

    Files younger than a minute are kept, because a running process may not have locked them yet.
    """
    folder, removed = expand_home(directory, 'map_directory'), []
    for path in abandoned_scratch_folders(folder):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _MIN_AGE_S:
                shutil.rmtree(path)
                removed.append(path.name)
    return removed


def _check_name(name: str, directory: str) -> None:
    # Refuse names that cannot be printed in one line, names of hidden files, and paths.
    if not name.isprintable() or name.startswith('.') or '/' in name:
        raise InputError(
            f'"{printable(name)}" is no plain file name; files are in {directory} only'
        )


def _with_ending(name: str, kind: FileKind) -> str:
    """Return a name with the kind's ending, which is appended if the name has none.

    InputError for another ending. A number after the last dot is no ending: "2024.05.17" has none.
    """
    ending = Path(name).suffix
    if ending in kind.endings:
        return name
    if ending[1:].isalpha() and len(ending) <= _MAX_ENDING + 1:
        raise InputError(f'"{printable(name)}": {kind.noun} ends in {" or ".join(kind.endings)}')
    return name + kind.endings[0]


def printable(name: str) -> str:
    """Return the beginning of a text from a request, with non-printable characters replaced."""
    text = ''.join(c if c.isprintable() else '?' for c in name[:_MAX_PRINTED])
    return text + '...' * (len(name) > _MAX_PRINTED)
