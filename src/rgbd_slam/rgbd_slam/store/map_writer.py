"""Writes a map to the tables of a database: as a whole, or what has changed in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

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
    """Writes a map that changes to a database, each time what has changed since the last time.

    The first time, the content of the database is replaced.

    Args:
        database: A database with the tables `TABLES`, or one that `Database.start` made.
        atlas: The map.
    """

    def __init__(self, database: Database, atlas: Atlas) -> None:
        self.parts = MapParts(atlas)
        self._database, self._atlas = database, atlas
        self._stored: KeyframeCopy | None = None  # None: nothing of this map is stored

    def write(self, copies: Iterable[tuple[MapPart, MapHeader]]) -> None:
        """Write parts of the map in one transaction.

        If anything raises, nothing is written, and the next call writes these parts again.

        Args:
            copies: Yields parts as `parts.copy` returns them, one after the other, until one has
                keyframes, each with the header of the map at that time.

        Raises:
            MapFileError: The database cannot be written.
            Exception: Whatever `copies` raises.
        """
        stored = self._stored
        with self._database.transaction(), self.parts.undone_if_failed():
            if stored is None:
                for table in TABLES:
                    self._database.clear(table)
            for part, header in copies:
                put_part(self._database, part)
                if part.keyframes is not None:
                    put_keyframes(self._database, part.keyframes, stored)
                    put_header(self._database, header)
                    put_loops(self._database, self._atlas.loops)
                    stored = part.keyframes
        self._stored = stored

    def touch(self, header: MapHeader) -> None:
        """Write only the header of a map that has not changed since the last `write`."""
        with self._database.transaction():
            put_header(self._database, header)


def put_header(database: Database, header: MapHeader) -> None:
    """Write the header of a map."""
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


def put_keyframes(
    database: Database, keyframes: KeyframeCopy, stored: KeyframeCopy | None = None
) -> None:
    """Write the keyframes that differ from the stored ones, and delete those that are gone.

    Args:
        database: The database.
        keyframes: All keyframes.
        stored: The keyframes that are stored; None: there are none.
    """
    is_new = np.ones(len(keyframes.uid), np.bool_)
    if stored is not None:
        _, at, stored_at = np.intersect1d(
            keyframes.uid, stored.uid, assume_unique=True, return_indices=True
        )
        pairs = [(new[at], old[stored_at]) for new, old in zip(keyframes, stored, strict=True)]
        is_new[at] = np.any(
            [(new != old).reshape(len(at), -1).any(axis=1) for new, old in pairs], axis=0
        )
        gone = np.setdiff1d(stored.uid, keyframes.uid, assume_unique=True).tolist()
        for table in (KEYFRAMES, FEATURES, STATES):
            database.delete(table, gone)
    *numbers, poses = (column[is_new] for column in keyframes)
    columns = (column.tolist() for column in numbers)
    database.put(KEYFRAMES, zip(*columns, map(Pose, poses), strict=True))


def put_loops(database: Database, edges: Sequence[LoopEdge]) -> None:
    """Replace the loop edges of a map."""
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
    """Yield the rows of a record in runs, of which these are the ends."""
    arrays, start = list(record.arrays().values()), 0
    for end in ends.tolist():
        yield type(record)(*(array[start:end] for array in arrays))
        start = end
