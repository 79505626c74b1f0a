"""The database from which a node that was killed restores the scene.

It has the images of the dense map, and the dense map and the object map that were loaded from
files. The anchors in it are uids of keyframes of the session, which has a row of its own.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import HoidError, MapFileError
from hoid_common.store.database import Database, OwnerLock, side_files
from hoid_common.store.table import Table
from hoid_common.values import IntArray
from hoid_scene.dense.view_store import IMAGES, VIEWS, ViewStore
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import OBJECTS, SUBMAPS, SavedScene

SESSION = Table('scene_session', 'number', {'name': str, 'num_loaded': int})
TABLES = (SESSION, VIEWS, IMAGES, *scene_file.TABLES)


class StoredSession(NamedTuple):
    """The session of a stored scene."""

    name: str
    num_loaded: int  # number of map files whose scene is in the store


class SceneStore:
    """The scene of one session on the disk.

    Its methods raise MapFileError if the database cannot be read or written.

    Raises:
        MapFileError: Another process of this name has the store.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self._path = path
        self._lock = OwnerLock(path.with_suffix('.lock'), owner)
        self._database: Database | None = None
        self.session: StoredSession | None = None
        if path.exists():
            self._reopen()

    def begin(self, session: str) -> ViewStore:
        """Discard the stored scene, and return the store of the images of another session.

        After an error, such as InputError for a folder that cannot be written, nothing is stored
        until the next session.
        """
        self._discard()
        try:
            self._database = Database.start(self._path, TABLES)
            self._note(StoredSession(session, 0))
            return ViewStore(self._database)
        except HoidError:
            self._discard()
            raise

    def views(self) -> ViewStore:
        return ViewStore(self._require())

    def loaded(self) -> SavedScene:
        """Return the dense map that was loaded and the object map; anchors are uids."""
        return scene_file.read(self._require())

    def add_loaded(self, scene: SavedScene, num_loaded: int) -> None:
        database = self._database
        if database is None:
            return
        first = database.count(SUBMAPS)
        states = [] if scene.dense is None else scene.dense.split()
        with database.transaction():
            database.put(SUBMAPS, enumerate(states, first))
        assert self.session is not None
        self._note(self.session._replace(num_loaded=num_loaded))

    def put_objects(self, objects: ObjectMapState | None) -> None:
        database = self._database
        if database is None:
            return
        with database.transaction():
            database.clear(OBJECTS)
            if objects is not None:
                database.put(OBJECTS, [(0, objects)])

    def rename(self, name: str, uids: IntArray, new_uids: IntArray) -> None:
        """Make the scene that of another session, which has the keyframes under other uids."""
        database, scene = self._require(), self.loaded()
        new = dict(zip(uids.tolist(), new_uids.tolist(), strict=True))
        views = list(database.rows(VIEWS))
        with database.transaction():
            gone = [slot for slot, uid, _ in views if uid not in new]
            for table in (VIEWS, IMAGES):
                database.delete(table, gone)
            database.put(VIEWS, [(s, new[uid], pose) for s, uid, pose in views if uid in new])
        scene_file.write(database, scene.renamed(uids, new_uids))
        assert self.session is not None
        self._note(self.session._replace(name=name, num_loaded=1))

    def close(self, *, keep: bool) -> None:
        """Close the store; `keep`: leave it for the next process of the node."""
        if keep and self._database is not None:
            self._database.close()
            self._database = None
        else:
            self._discard()
        self._lock.release()

    def _reopen(self) -> None:
        try:
            self._database = Database.open(self._path, TABLES)
            for _, *session in self._database.rows(SESSION):
                self.session = StoredSession(*session)
        except MapFileError:
            self._discard()

    def _note(self, session: StoredSession) -> None:
        self.session = session
        self._require().put(SESSION, [(0, *session)])

    def _require(self) -> Database:
        assert self._database is not None
        return self._database

    def _discard(self) -> None:
        if self._database is not None:
            self._database.close()
        self._database, self.session = None, None
        for path in (self._path, *side_files(self._path)):
            with suppress(OSError):  # a disk that is read-only, as the next session reports
                path.unlink(missing_ok=True)
