"""Writing of a map to the tables of a database, as a whole or only its changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hoid_common.io.records import Record
from hoid_common.store.database import Database
from hoid_common.values import IntArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.store.map_parts import KeyframeCopy, MapPart, MapParts
from rgbd_slam.store.tables import (
    CHUNK,
    FEATURES,
    KEYFRAMES,
    LOOPS,
    META,
    POINTS,
    STATES,
    TABLES,
    CameraRow,
    Covariance,
    MapHeader,
    Pose,
)


class MapWriter:
    """Writes the changes of a map to a database, in transactions.

    A transaction is `begin`, then `append` for each part of the map. Between transactions, the
    database is closed, so that its disk can become read-only. The whole map is written the first
    time, and again if the database was deleted or replaced.
    """

    def __init__(self, atlas: Atlas, open_database: Callable[[], Database]) -> None:
        self.atlas = atlas
        self._open_database = open_database
        self._parts = MapParts(atlas)
        self._before = self._parts.state()  # copied rows at `begin`
        self._database: Database | None = None  # None: there is no transaction
        # Keyframes in the database; None: this map is not stored.
        self._stored_uids: IntArray | None = None
        # Keyframes whose features were written.
        self._written_uids: IntArray = np.empty(0, np.int64)

    @property
    def is_open(self) -> bool:
        return self._database is not None

    def begin(self) -> None:
        """Begin a transaction; MapFileError if the database cannot be written."""
        self._database = database = self._open_database()
        try:
            database.begin()
            stored = self._stored_uids
            if stored is None or database.count(KEYFRAMES) != len(stored):
                self._stored_uids, stored = None, np.empty(0, np.int64)
                self._parts = MapParts(self.atlas)
                for table in TABLES:
                    database.clear(table)
            self._before, self._written_uids = self._parts.state(), stored
        except BaseException:
            self.abort()
            raise

    def copy(self) -> MapPart:
        """Return a copy of the next part of the map, for `append`; called between two images."""
        return self._parts.copy()

    def append(self, part: MapPart, header: MapHeader) -> bool:
        """Write a part that `copy` returned; return whether it was the last one, which commits.

        MapFileError if the database cannot be written; it is unchanged then.
        """
        assert self._database is not None
        try:
            put_part(self._database, part)
            self._written_uids = np.union1d(self._written_uids, part.new_uids)
            if part.keyframes is None:
                return False
            put_keyframes(self._database, part.keyframes)
            removed = np.setdiff1d(self._written_uids, part.keyframes.uid).tolist()
            for table in (FEATURES, STATES):
                self._database.delete(table, removed)
            put_loops(self._database, part.loops)
            put_header(self._database, header)
            self._database.commit()
        except BaseException:
            self.abort()
            raise
        self._stored_uids = part.keyframes.uid
        self._close()
        return True

    def abort(self) -> None:
        """Undo the transaction, if there is one."""
        if self._database is not None:
            self._database.rollback()
            self._parts.restore(self._before)
            self._close()

    def touch(self, header: MapHeader) -> None:
        """Write only the header of a map that has not changed since the last transaction."""
        with self._open_database() as database:
            put_header(database, header)

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None


def put_header(database: Database, header: MapHeader) -> None:
    camera, T_map_core = CameraRow.of_camera(header.camera), Pose(header.T_map_core)
    octaves = header.scale_factor, header.num_octaves
    database.put(META, [(0, camera, *octaves, T_map_core, header.session, header.stamp_ns)])


def put_part(database: Database, part: MapPart) -> None:
    """Write the features, states and points of a part."""
    features = _runs(part.features, np.cumsum(part.new_counts))
    database.put(FEATURES, zip(part.new_uids.tolist(), features, strict=True))
    states = _runs(part.states, np.cumsum(part.changed_counts))
    database.put(STATES, zip(part.changed_uids.tolist(), states, strict=True))
    points = _runs(part.points, np.searchsorted(part.points.row, (part.chunks + 1) * CHUNK))
    database.put(POINTS, zip(part.chunks.tolist(), points, strict=True))


def put_keyframes(database: Database, keyframes: KeyframeCopy) -> None:
    """Replace all keyframes of a map; this takes 6 ms for 1,000 keyframes."""
    *numbers, poses = keyframes
    columns = (column.tolist() for column in numbers)
    database.clear(KEYFRAMES)
    database.put(KEYFRAMES, zip(*columns, map(Pose, poses), strict=True))


def put_loops(database: Database, edges: Sequence[LoopEdge]) -> None:
    database.clear(LOOPS)
    rows = (
        (
            n,
            e.first_uid,
            e.second_uid,
            e.kind,
            e.num_inliers,
            e.found_share,
            e.residual_m,
            int(e.is_used),
            Pose(e.T_first_second),
            Covariance(e.covariance),
        )
        for n, e in enumerate(edges)
    )
    database.put(LOOPS, rows)


def _runs(record: Record, ends: IntArray) -> Iterator[Record]:
    """Yield the rows of a record in runs; each ends before the next of the rows `ends`."""
    arrays, start = list(record.arrays().values()), 0
    for end in ends.tolist():
        yield type(record)(*(array[start:end] for array in arrays))
        start = end
