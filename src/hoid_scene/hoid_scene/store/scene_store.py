"""The database from which a node that was killed restores the scene.

It has the images of the dense map, and the dense map and the object map that were loaded from
files. The anchors in it are uids of keyframes of the session, which has a row of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import HoidError, MapFileError
from hoid_common.store.database import Database, OwnerLock, side_files
from hoid_common.store.table import Table
from hoid_common.values import IntArray
from hoid_scene.dense.view_store import IMAGES, VIEWS, ViewStore
from hoid_scene.memory.object_memory import NO_MEMORIES, MemoryState
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import MEMORIES, OBJECTS, SUBMAPS, SavedScene

SESSION = Table('scene_session', 'number', {'name': str, 'num_loaded': int, 'is_reused': int})
LOADED = Table('scene_loaded', 'object', {})  # numbers of the objects from maps of other sessions
TABLES = (SESSION, LOADED, VIEWS, IMAGES, *scene_file.TABLES)


class StoredSession(NamedTuple):
    """The session of a stored scene."""

    name: str
    num_loaded: int  # number of map files whose scene is in the store
    is_reused: int  # 1: one of these maps has objects


class SceneStore:
    """The scene of one session on the disk.

    Its methods raise MapFileError if the database cannot be read or written. The constructor
    raises it if another process of this name uses the store.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self._path = path
        self._lock = OwnerLock(path.with_suffix('.lock'), owner)
        self._database: Database | None = None
        self.session: StoredSession | None = None
        # Memories that this process has stored; None: the store may contain others.
        self._memories: Mapping[int, MemoryState] | None = None
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
            self._note(StoredSession(session, 0, 0))
            return ViewStore(self._database)
        except HoidError:
            self._discard()
            raise

    def views(self) -> ViewStore:
        return ViewStore(self._require())

    def loaded(self) -> SavedScene:
        """Return the dense map that was loaded and the object map; anchors are uids."""
        return scene_file.read(self._require())

    def add_loaded(
        self, scene: SavedScene, num_loaded: int, objects: ObjectMap | None, uids: IntArray
    ) -> None:
        """Store the dense map of a loaded scene, and all objects that the map now has."""
        database = self._database
        if database is None:
            return
        first = database.count(SUBMAPS)
        states = [] if scene.dense is None else scene.dense.split()
        with database.transaction():
            database.put(SUBMAPS, enumerate(states, first))
            memories = self._put_objects(database, objects, uids)
            assert self.session is not None
            is_reused = int(objects is not None and objects.is_reused)
            self._note(StoredSession(self.session.name, num_loaded, is_reused))
        self._memories = memories

    def put_objects(self, objects: ObjectMap | None, uids: IntArray) -> None:
        """Store the objects that are anchored to keyframes with ascending uids (K,)."""
        if self._database is not None:
            with self._database.transaction():
                memories = self._put_objects(self._database, objects, uids)
            self._memories = memories

    def _put_objects(
        self, database: Database, objects: ObjectMap | None, uids: IntArray
    ) -> Mapping[int, MemoryState]:
        scene, before = scene_file.exported_objects(objects, uids), self._memories
        loaded = [] if objects is None else objects.loaded_ids
        for table in (OBJECTS, LOADED):
            database.clear(table)
        if scene.objects is not None:
            database.put(OBJECTS, [(0, scene.objects)])
        database.put(LOADED, [(number,) for number in loaded])
        if before is None:
            database.clear(MEMORIES)
            before = NO_MEMORIES
        database.delete(MEMORIES, before.keys() - scene.memories.keys())
        changed = [row for row in scene.memories.items() if before.get(row[0]) is not row[1]]
        database.put(MEMORIES, changed)
        return scene.memories

    def restore(self, objects: ObjectMap | None) -> None:
        """Set in the object map, after loading it, which objects are from other sessions."""
        loaded = {number for (number,) in self._require().rows(LOADED)}
        if objects is not None and self.session is not None:
            objects.restore(loaded, is_reused=bool(self.session.is_reused))

    def rename(self, name: str, uids: IntArray, new_uids: IntArray) -> None:
        """Assign the scene to another session, in which the keyframes have other uids."""
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
        self._database, self.session, self._memories = None, None, None
        for path in (self._path, *side_files(self._path)):
            with suppress(OSError):  # a read-only disk, which the next session reports
                path.unlink(missing_ok=True)
