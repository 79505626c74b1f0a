"""Reading of a map from the tables of a database."""

from __future__ import annotations

import numpy as np

from hoid_common.errors import MapFileError
from hoid_common.io.records import Array, Record
from hoid_common.store.database import Database
from hoid_common.store.table import Table
from hoid_common.values import IntArray
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import MapState, rows_of_uids
from rgbd_slam.store.tables import (
    FEATURES,
    KEYFRAMES,
    LOOPS,
    META,
    POINTS,
    STATES,
    TABLES,
    FeatureRows,
    MapHeader,
    PointRows,
    StateRows,
)


def read_map(
    database: Database,
) -> tuple[MapHeader, IntArray, MapState, tuple[LoopEdge, ...]]:
    """Return header, keyframe uids (K,), map, and loop edges between uids, all unchecked.

    The map is in the core's map frame.

    Raises:
        MapFileError: The database is damaged or has no map. The text need not name the file.
        ConfigError: The camera is invalid.
    """
    missing = [table.name for table in TABLES if not database.has(table)]
    row = None if missing else database.row(META, 0)
    if row is None:
        raise MapFileError('has no map')
    _, camera, scale_factor, num_octaves, T_map_core, *rest = row
    header = MapHeader(camera.camera(), scale_factor, num_octaves, T_map_core.T, *rest)
    loops = (
        LoopEdge(first, second, pose.T, covariance.matrix, count, share, kind, error_m, bool(used))
        for _, first, second, kind, count, share, error_m, used, pose, covariance in database.rows(
            LOOPS
        )
    )
    return header, *_state(database), tuple(loops)


def _state(database: Database) -> tuple[IntArray, MapState]:
    uid, keyframes = _keyframes(database)
    counts, features = _joined(database, FEATURES, FeatureRows, uid)
    state_counts, states = _joined(database, STATES, StateRows, uid)
    _, points = _joined(database, POINTS, PointRows)
    if not np.array_equal(counts, state_counts):
        raise MapFileError('is damaged: a keyframe lacks features or their states')
    states['point'] = _indices(points.pop('row'), states['point'])
    points['reference'] = rows_of_uids(uid, points.pop('reference_uid'))
    return uid, MapState.of(keyframes | {'num_features': counts} | features | states | points)


def _keyframes(database: Database) -> tuple[IntArray, dict[str, Array]]:
    rows = list(database.rows(KEYFRAMES))
    uid, stamp_ns, map_id, parent_uid = (
        np.array([row[n] for row in rows], np.int64) for n in range(4)
    )
    if uid.min(initial=0) < 0:
        raise MapFileError('is damaged: a number of a keyframe is negative')
    return uid, {
        'stamp_ns': stamp_ns,
        'T_map_camera': np.array([row[4].T for row in rows]).reshape(-1, 4, 4),
        'map_id': np.unique(map_id, return_inverse=True)[1],
        'parent': rows_of_uids(uid, parent_uid),
    }


def _joined(
    database: Database, table: Table, kind: type[Record], keys: IntArray | None = None
) -> tuple[IntArray, dict[str, Array]]:
    """Return the lengths (R,) of a table's records, and their concatenated columns."""
    columns: dict[str, list[Array]] = {name: [_empty(kind, name)] for name in kind.columns()}
    counts, found = [], []
    for key, record in database.rows(table):
        found.append(key)
        arrays = record.arrays()
        for name, array in arrays.items():
            columns[name].append(array)
        counts.append(len(array))
    if keys is not None and not np.array_equal(keys, found):
        raise MapFileError(f'is damaged: the {table.name} are not those of its keyframes')
    return np.array(counts, np.int64), {n: np.concatenate(c) for n, c in columns.items()}


def _empty(kind: type[Record], name: str) -> Array:
    column = kind.columns()[name]
    return np.empty([axis if isinstance(axis, int) else 0 for axis in column.axes], column.dtype)


def _indices(rows: Array, observed: Array) -> IntArray:
    """Return, for each feature (F,), the index among the points (P,) of its observed point.

    Both arrays have rows of points in the table that was written, or NO_POINT.
    """
    capacity = 1 + max(int(rows.max(initial=-1)), int(observed.max(initial=-1)))
    if min(int(rows.min(initial=0)), int(observed.min(initial=NO_POINT)) + 1) < 0:
        raise MapFileError('is damaged: a row of a point is negative')
    # Zeros take no memory until they are written, however large a row a hostile file names. The
    # last element belongs to NO_POINT = -1.
    number = np.zeros(capacity + 1, np.int32)
    number[rows] = np.arange(1, len(rows) + 1)
    index = number[observed]
    if ((index == 0) & (observed != NO_POINT)).any():
        raise MapFileError('lacks a point that a feature observes')
    return np.asarray(index - 1)
