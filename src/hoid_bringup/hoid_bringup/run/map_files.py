"""Options of an offline run for map files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import ConfigError
from hoid_common.io.files import check_writable


class MapFiles(NamedTuple):
    """The map files that a run loads and saves."""

    load: Path | None = None  # map to start with; None: an empty map
    localize: bool = False  # whether the loaded map stays unchanged
    save: Path | None = None  # file in which to save the map at the end; None: it is not saved

    def check(self) -> None:
        """Refuse options that contradict each other, or a file that cannot be saved."""
        if self.localize and self.load is None:
            raise ConfigError('--localize needs --map FILE')
        if self.save is not None:
            if self.save.is_dir():  # `--save-map ''` is the current folder
                raise ConfigError(f'--save-map {self.save}: is a folder; name a file')
            check_writable(self.save.parent)
