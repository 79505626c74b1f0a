"""Files that services may touch: names in one folder, nothing outside."""

from __future__ import annotations

from pathlib import Path

from hoid_common.errors import InputError
from rgbd_slam.map_io.map_file import SUFFIX

_MAP_NAME = 'map'


def map_path(directory: str, name: str) -> Path:
    """Return the path of a map file by its name, with or without suffix; raises as `path_in`."""
    path = path_in(directory, name, _MAP_NAME)
    return path if path.suffix == SUFFIX else path_in(directory, path.name + SUFFIX, '')


def path_in(directory: str, name: str, default: str) -> Path:
    """Return the path of a named file in the folder, which is made when missing.

    Args:
        directory: The folder; `~` is the home folder.
        name: A plain file name; empty means `default`.
        default: The name to take then.

    Raises:
        InputError: The name would or might lead out of the folder, or that cannot be made.
    """
    name = name or default
    if Path(name).name != name or name in ('.', '..') or '\0' in name:
        raise InputError(
            f'"{name}" is no plain file name; files lie in {directory} and not outside'
        )
    folder = Path(directory).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder}: cannot be made: {error.strerror}') from error
    path = folder / name
    if path.is_symlink():
        raise InputError(f'{path} is a link, and may lead out of the folder; use another name')
    return path
