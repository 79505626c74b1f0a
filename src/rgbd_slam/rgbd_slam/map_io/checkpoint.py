"""The checkpoint file: the map of a node that was killed, for the node that replaces it.

The modification time of the file is the stamp of the last image that was tracked in its map, on
the camera's clock. It shows whether the map fits the images that a new node receives: the stamps
of a running camera are later by the time for which no node was running. Those of a recording that
is played again are earlier, and those of another recording differ by more than ten minutes.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import NamedTuple

from hoid_common.errors import MapFileError
from hoid_common.io.untrusted import expand_home
from hoid_common.values import NS_PER_S
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_file import SUFFIX, MapFile

# Chosen: after more than ten minutes without SLAM the robot may be anywhere.
_MAX_AWAY_NS = 600 * NS_PER_S


class Checkpoint(NamedTuple):
    """A map and the time until which it was extended."""

    content: MapFile
    stamp_ns: int  # of the last image tracked in it

    def is_recent(self, stamp_ns: int) -> bool:
        """Return whether a camera whose image has this stamp is probably still in the map."""
        return 0 <= stamp_ns - self.stamp_ns <= _MAX_AWAY_NS


class CheckpointFile:
    """The checkpoint file of one node.

    Args:
        directory: The folder of all maps; `~` is the home folder.
        owner: Name of the node, which must be unique on this machine.
    """

    def __init__(self, directory: str, owner: str) -> None:
        plain = ''.join(c if c.isalnum() else '-' for c in owner)
        # A hidden file, which no service accepts as a name.
        self.path = expand_home(directory, 'map_directory') / f'.checkpoint-{plain}{SUFFIX}'

    def read(self) -> Checkpoint | None:
        """Return the checkpoint, or None if there is none.

        Raises:
            MapFileError: It cannot be read.
        """
        if not self.path.exists():
            return None
        return Checkpoint(map_file.load(self.path), self.path.stat().st_mtime_ns)

    def write(self, checkpoint: Checkpoint) -> int:
        """Write a checkpoint in place of the old one, and return the size of the file in bytes.

        Raises:
            MapFileError: It cannot be written; the old file is unchanged.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MapFileError(
                f'{self.path.parent}: cannot be created: {error.strerror}'
            ) from error
        size = map_file.save(self.path, checkpoint.content)
        self.touch(checkpoint.stamp_ns)
        return size

    def touch(self, stamp_ns: int) -> None:
        """Record that the map in the file still holds at the image with this stamp."""
        with suppress(OSError):
            os.utime(self.path, ns=(stamp_ns, stamp_ns))

    def remove(self) -> None:
        """Delete the file, so that no node resumes its map."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
