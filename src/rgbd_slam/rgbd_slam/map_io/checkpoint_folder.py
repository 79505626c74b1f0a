"""The checkpoint of a node: its map on the disk, which the next node resumes if it is killed.

A checkpoint is a folder with segments, to which only new and changed rows are appended, and an
index (decision 042). The modification time of the index is the stamp of the last image that was
tracked in its map, on the camera's clock: the stamps of a running camera are later by the time for
which no node was running, and those of a recording that is played again are earlier. A map is
never deleted. When no node is to resume it any more, its folder is renamed to that of a saved map
(decision 030).
"""

from __future__ import annotations

import itertools
import os
import shutil
from contextlib import suppress
from pathlib import Path
from time import strftime
from typing import NamedTuple

from hoid_common.errors import MapFileError
from hoid_common.io.untrusted import expand_home
from hoid_common.process.ownership import Ownership
from hoid_common.store.database import SUFFIX
from rgbd_slam.map_io import archive
from rgbd_slam.map_io.checkpoint_index import INDEX, read_checkpoint
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile


class Checkpoint(NamedTuple):
    """The map that was read from a checkpoint, and the time until which it was extended."""

    content: MapFile
    stamp_ns: int  # of the last image tracked in it


def set_stamp(index: Path | int, stamp_ns: int) -> None:
    """Set the modification time of an index (path or file descriptor) to an image's stamp.

    Errors are ignored.
    """
    with suppress(OSError):
        os.utime(index, ns=(stamp_ns, stamp_ns))


class CheckpointFolder:
    """The checkpoint of one node.

    Args:
        directory: The folder of all maps; `~` is the home folder.
        owner: Name of the node, which must be unique on this machine. In the name of the folder,
            characters other than letters and digits are replaced by "-".

    Raises:
        ConfigError: `directory` begins with `~`, and the home folder is not known.
    """

    def __init__(self, directory: str, owner: str) -> None:
        plain = ''.join(c if c.isalnum() else '-' for c in owner)
        # Hidden, so that no service accepts it as a name.
        self.path = expand_home(directory, 'map_directory') / f'.checkpoint-{plain}'
        self._index = self.path / INDEX
        self._ownership: Ownership | None = None

    def outdated(self) -> str:
        """Return a warning about the checkpoint of an earlier version, a map file; '' if none."""
        path = self.path.with_name(self.path.name + SUFFIX)
        if not path.exists():
            return ''
        return (
            f'{path} is a checkpoint of an earlier version and is not used: delete it, or rename '
            f'it to a name without a dot in front, such as crash{SUFFIX}, for load_map'
        )

    def read(self) -> Checkpoint | None:
        """Return the checkpoint, or None if there is none.

        Raises:
            MapFileError: It cannot be read, is damaged, or is of another version.
        """
        if not self._index.exists():
            return None
        stamp_ns = self._index.stat().st_mtime_ns
        return Checkpoint(read_checkpoint(self._index), stamp_ns)

    @property
    def is_owned(self) -> bool:
        """Return whether this process may write checkpoints here, which `own` asks for."""
        return self._ownership is not None

    def own(self, name: str) -> None:
        """Make this process the only one that writes checkpoints here, until `disown` or its end.

        Raises:
            InputError: Another process does; `name` is the full name of its node.
        """
        lock = self.path.with_name(self.path.name.replace('.checkpoint', '.owner'))
        self._ownership = Ownership(lock, name)

    def disown(self) -> None:
        """Let other processes write checkpoints here."""
        if self._ownership is not None:
            self._ownership.close()
            self._ownership = None

    def touch(self, stamp_ns: int) -> None:
        """Set the stamp of the last image tracked in the unchanged map; errors are ignored."""
        set_stamp(self._index, stamp_ns)

    def keep(self, *, is_copy: bool = False) -> str:
        """Give the map a name of its own, under which it can be loaded as a saved map.

        Args:
            is_copy: The checkpoint stays as well, so that a node resumes it. The copy takes no
                space where the file system has hard links, because the files of a checkpoint are
                replaced and never overwritten.

        Returns:
            A line for the log that says where the map is, and how to load it; empty if there is no
            checkpoint, or the copy exists already.

        Raises:
            MapFileError: The folder cannot be renamed or copied; the checkpoint is unchanged.
        """
        try:
            if not self._index.exists() or (is_copy and self._index.stat().st_nlink > 1):
                return ''
            path, what = self._free_path(), _described(self._index)
            if is_copy:
                shutil.copytree(self.path, path, copy_function=_link_or_copy)
            else:
                self.path.rename(path)
        except OSError as error:
            raise MapFileError(
                f'{self.path}: the map cannot be kept under another name: {error.strerror}'
            ) from error
        archive.sync_folder(path.parent)
        return f'{what} kept as {path}; load it with load_map or map_file, by the name {path.stem}'

    def _free_path(self) -> Path:
        name = strftime('kept-%Y%m%d-%H%M%S')
        names = itertools.chain([name], (f'{name}-{n}' for n in itertools.count(2)))
        paths = (self.path.with_name(name + SUFFIX) for name in names)
        return next(path for path in paths if not path.exists())


def _link_or_copy(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # the file system has no hard links
        shutil.copy2(source, target)


def _described(index: Path) -> str:
    try:
        lengths = archive.read(index, lambda reader: reader.manifest()['lengths'])
        return f'map of {lengths["keyframes"]["keyframes"]} keyframes'
    except MapFileError:
        return 'damaged map'


def load_map(path: Path) -> MapFile:
    """Return the map of a file that was saved, or of a checkpoint that was kept (a folder).

    Raises:
        MapFileError: It does not exist, cannot be read, is no map of this version, is damaged, or
            does not fit into memory.
    """
    return read_checkpoint(path / INDEX) if path.is_dir() else map_file.load(path)
