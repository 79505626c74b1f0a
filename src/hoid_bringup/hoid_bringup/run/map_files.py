"""Options of an offline run for map files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import ConfigError
from hoid_common.io.files import check_writable


class MapFiles(NamedTuple):
    """Map files of a run."""

    load: Path | None = None
    localize: bool = False  # whether the loaded map stays unchanged
    save: Path | None = None

    def check(self) -> None:
        """Raise HoidError if the options contradict each other or a file cannot be written."""
        if self.localize and self.load is None:
            raise ConfigError('--localize needs --map FILE')
        if self.save is not None:
            if self.save.is_dir():  # `--save-map ''` is the current folder
                raise ConfigError(f'--save-map {self.save}: is a folder; name a file')
            check_writable(self.save.parent)
