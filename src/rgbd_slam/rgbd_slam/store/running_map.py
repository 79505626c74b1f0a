"""The database of a node's running map, which the next node resumes after a crash.

A map is never deleted. If no node should resume it any more, its database gets the name of a saved
map.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import strftime

from hoid_common.errors import MapFileError, counted
from hoid_common.io.untrusted import expand_home
from hoid_common.store.database import SUFFIX, Database, OwnerLock, kept, side_files
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile
from rgbd_slam.store.map_writer import MapWriter
from rgbd_slam.store.tables import KEYFRAMES, TABLES

_KEPT = 'kept-'  # beginning of the names of kept maps
_MB = 1e6


class RunningMap:
    """The database `.running-NODE.hoidmap` of a node's map; `owner` identifies the node."""

    def __init__(self, directory: str, owner: str) -> None:
        plain = ''.join(c if c.isalnum() else '-' for c in owner)
        folder = expand_home(directory, 'map_directory')
        # Hidden, so that no service accepts it as a name.
        self.path = folder / f'.running-{plain}{SUFFIX}'
        self._old = folder / f'.checkpoint-{plain}'
        self._lock: OwnerLock | None = None

    @property
    def is_owned(self) -> bool:
        """Return whether this process may write the database, because `own` was called."""
        return self._lock is not None

    def own(self, name: str) -> None:
        """Make this process the only writer; MapFileError if another process already is."""
        self._lock = OwnerLock(self.path.with_suffix('.lock'), name)

    def disown(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def outdated(self) -> str:
        """Return a warning about a checkpoint of version 0.3 or earlier; '' if there is none."""
        found = [path for path in (self._old, self._old.with_suffix(SUFFIX)) if path.exists()]
        if not found:
            return ''
        return f'{found[0]} is a checkpoint of version 0.3 or earlier and is not used: delete it'

    def read(self) -> MapFile | None:
        """Return the map in the database; None if it has none, MapFileError if it is damaged."""
        return map_file.load(self.path) if self._num_keyframes() != 0 else None

    def writer(self, atlas: Atlas) -> MapWriter:
        """Return the writer of a map that replaces the stored map; call `keep` before."""
        return MapWriter(atlas, self._open)

    def copy_to(self, path: Path) -> None:
        with Database.open(self.path, TABLES, is_own=True) as database:
            database.copy_to(path)

    def keep(self) -> str:
        """Give the database the name of a saved map; return a log line, or '' if it has no map."""
        count = self._num_keyframes()
        if count == 0:
            for path in (self.path, *side_files(self.path)):
                path.unlink(missing_ok=True)
            return ''
        with suppress(MapFileError):  # the journal of a damaged map is renamed too
            Database.open(self.path, [], is_own=True).finish()
        path = kept(self.path, self.path.with_name(strftime(f'{_KEPT}%Y%m%d-%H%M%S{SUFFIX}')))
        what = 'unreadable map' if count is None else f'map of {counted(count, "keyframe")}'
        return (
            f'{what} kept as {path}; load it with load_map or map_file, by the name {path.stem}. '
            + self._all_kept()
        )

    def _all_kept(self) -> str:
        paths = list(self.path.parent.glob(f'{_KEPT}*{SUFFIX}'))
        size_mb = sum(path.stat().st_size for path in paths) / _MB
        return (
            f'{len(paths)} kept maps take {size_mb:.0f} MB in {self.path.parent}: "hoid map info" '
            'says what is in them; delete those that you do not need'
        )

    def _open(self) -> Database:
        if self.path.exists():
            return Database.open(self.path, TABLES, is_own=True)
        return Database.start(self.path, TABLES)

    def _num_keyframes(self) -> int | None:
        """Return the number of stored keyframes; 0 without a database, None if it is damaged."""
        if not self.path.exists():
            return 0
        try:
            with Database.open(self.path, [], is_own=True) as database:
                return database.count(KEYFRAMES) if database.has(KEYFRAMES) else 0
        except MapFileError:
            return None
