"""A map written at intervals, for the node that starts after one that was killed.

The time of the file is the stamp of the last image that was tracked in its map, on the camera's
clock: a camera that goes on is later by as long as the node was away, while a recording that is
played again is earlier, and another one far off.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import MapFileError
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_file import SUFFIX, MapFile

_MAX_AWAY_NS = 600 * 10**9  # longer, and the robot may be anywhere


class Checkpoint(NamedTuple):
    """What was read."""

    content: MapFile
    stamp_ns: int  # of the last image tracked in it

    def is_of(self, stamp_ns: int) -> bool:
        """Return whether the camera whose image has this stamp may well be in the map."""
        return 0 <= stamp_ns - self.stamp_ns <= _MAX_AWAY_NS


class CheckpointFile:
    """The file of one node.

    Args:
        directory: Of all maps; `~` is the home folder.
        owner: Name of the node, another one for each that may run beside it.
    """

    def __init__(self, directory: str, owner: str) -> None:
        plain = ''.join(c if c.isalnum() else '-' for c in owner)
        # Hidden, and so no name that a service takes.
        self.path = Path(directory).expanduser() / f'.checkpoint-{plain}{SUFFIX}'

    def read(self) -> Checkpoint | None:
        """Return what there is, if anything.

        Raises:
            MapFileError: It cannot be read.
        """
        if not self.path.exists():
            return None
        return Checkpoint(map_file.load(self.path), self.path.stat().st_mtime_ns)

    def write(self, checkpoint: Checkpoint) -> int:
        """Replace the file once a whole one is there; return its size in bytes.

        Raises:
            MapFileError: It cannot be written; what was there still is.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MapFileError(f'{self.path.parent}: cannot be made: {error.strerror}') from error
        size = map_file.save(self.path, checkpoint.content)
        self.touch(checkpoint.stamp_ns)
        return size

    def touch(self, stamp_ns: int) -> None:
        """Say that the map is still the same after the image with this stamp."""
        with suppress(OSError):
            os.utime(self.path, ns=(stamp_ns, stamp_ns))

    def remove(self) -> None:
        """Leave nothing to resume."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
