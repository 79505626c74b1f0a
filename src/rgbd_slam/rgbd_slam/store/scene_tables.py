"""The tables of the dense map and the object map, which the scene process provides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hoid_common.io.records import Array, Record, column
from hoid_common.store.database import Database
from hoid_common.store.table import Table
from hoid_common.values import IntArray
from hoid_scene.dense.submap_export import SubmapExport
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.model.map_state import rows_of_uids
from rgbd_slam.store.tables import Pose


@dataclass(frozen=True, eq=False)
class Uids(Record):
    """Uids of keyframes."""

    uid: Annotated[IntArray, column('i8', 'keyframes')]


SUBMAPS = Table('scene_submaps', 'number', {'contents': SubmapState})  # a single submap each
ANCHORS = Table('scene_anchors', 'number', {'anchor_uid': int, 'T_anchor_submap': Pose})
# Row 0, whose keyframes are those that the anchors of the objects are rows of.
OBJECTS = Table('scene_objects', 'id', {'keyframes': Uids, 'objects': ObjectMapState})
SCENE_TABLES = (SUBMAPS, ANCHORS, OBJECTS)
_OF_VOXELS = ('key', 'offset', 'color_bgr', 'weight', 'counts')


def put_scene(
    database: Database,
    dense: SubmapState | None,
    objects: ObjectMapState | None,
    uids: IntArray,
) -> None:
    """Write dense map and object map of a map with these keyframes; None: leave it out."""
    if dense is not None:
        numbers = np.arange(len(dense.anchor))
        put_submaps(database, numbers, uids[dense.anchor], dense.T_anchor_submap)
        _put_contents(database, numbers, dense)
    put_objects(database, objects, uids)


def put_export(database: Database, export: SubmapExport | None) -> None:
    """Write the changes of a dense map since the last export; None: there is no dense map."""
    if export is None:
        database.clear(SUBMAPS)
        database.clear(ANCHORS)
        return
    gone = {row[0] for row in database.rows(ANCHORS)} - set(export.numbers.tolist())
    database.delete(SUBMAPS, gone)
    put_submaps(database, export.numbers, export.anchor_uids, export.T_anchor_submap)
    _put_contents(database, export.changed_numbers, export.changed)


def put_submaps(database: Database, numbers: IntArray, uids: IntArray, T: Array) -> None:
    """Replace the anchors of all submaps."""
    database.clear(ANCHORS)
    database.put(ANCHORS, zip(numbers.tolist(), uids.tolist(), map(Pose, T), strict=True))


def put_objects(database: Database, objects: ObjectMapState | None, uids: IntArray) -> None:
    """Write an object map whose anchors are rows of the keyframes with these uids."""
    if objects is None:
        database.clear(OBJECTS)
    else:
        database.put(OBJECTS, [(0, Uids(uids), objects)])


def _put_contents(database: Database, numbers: IntArray, state: SubmapState) -> None:
    ends = np.cumsum(state.num_voxels)
    starts = ends - state.num_voxels
    runs = map(slice, starts.tolist(), ends.tolist())
    rows = (
        (number, SubmapState.of(_single(state.arrays(), n, run)))
        for n, (number, run) in enumerate(zip(numbers.tolist(), runs, strict=True))
    )
    database.put(SUBMAPS, rows)


def _single(arrays: Mapping[str, Array], n: int, voxels: slice) -> dict[str, Array]:
    return {
        name: array
        if name == 'voxel_m'
        else array[voxels if name in _OF_VOXELS else slice(n, n + 1)]
        for name, array in arrays.items()
    }


def read_scene(
    database: Database, uids: IntArray
) -> tuple[SubmapState | None, ObjectMapState | None]:
    """Return dense map and object map of a map with these keyframes; None: there is none.

    Submaps and objects whose anchors are not among the keyframes are left out.
    """
    objects = database.row(OBJECTS, 0) if database.has(OBJECTS) else None
    state = None if objects is None else objects[2].reanchored(rows_of_uids(uids, objects[1].uid))
    if not database.has(SUBMAPS):
        return None, state
    contents, parts, anchors = dict(database.rows(SUBMAPS)), [], []
    for number, uid, pose in database.rows(ANCHORS):
        if number in contents and uid in uids:
            parts.append({**contents[number].arrays(), 'T_anchor_submap': pose.T[None]})
            anchors.append(uid)
    if not parts:
        return None, state
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    anchor = rows_of_uids(uids, np.array(anchors))
    return SubmapState.of({**joined, 'anchor': anchor, 'voxel_m': parts[0]['voxel_m']}), state
