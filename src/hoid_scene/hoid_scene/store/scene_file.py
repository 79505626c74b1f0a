"""The scene in a map file: tables beside those of the SLAM node, anchored to its keyframes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MapFileError, counted
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.store.checks import require
from hoid_common.store.database import Database
from hoid_common.store.table import Table
from hoid_common.values import CameraModel, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectMapConfig, ObjectTrackerConfig
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.memory.object_memory import NO_MEMORIES, MemoryState
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.store.scene_check import check_memory, check_objects, check_submaps

# One row per submap, which bounds the memory to read a row, one row for the places of all objects,
# and one row for the memory of each object, so that only changed rows are written.
SUBMAPS = Table('scene_submaps', 'number', {'submap': SubmapState})
OBJECTS = Table('scene_objects', 'number', {'objects': ObjectMapState})
MEMORIES = Table('scene_memories', 'object', {'memory': MemoryState})
TABLES = (SUBMAPS, OBJECTS, MEMORIES)


class SavedScene(NamedTuple):
    """Dense map and object map; their anchors are uids of keyframes."""

    dense: SubmapState | None = None  # None: there is none
    objects: ObjectMapState | None = None  # None: there is none
    memories: Mapping[int, MemoryState] = NO_MEMORIES  # by the number of the object

    @property
    def summary(self) -> str:
        voxels = 0 if self.dense is None else len(self.dense)
        text = f'{counted(voxels, "voxel")} of the dense map'
        return text if self.objects is None else f'{text}, {counted(len(self.objects), "object")}'

    def renamed(self, uids: IntArray, new_uids: IntArray) -> SavedScene:
        """Return the scene with anchors changed from `uids` to `new_uids`, both (K,)."""
        dense, objects = self.dense, self.objects
        if dense is not None:
            dense = dense.with_anchors(_renamed(dense.anchor, uids, new_uids))
        if objects is not None:
            objects = objects.with_anchors(_renamed(objects.anchor, uids, new_uids))
        return SavedScene(dense, objects, self.memories)


class JoinedScenes(NamedTuple):
    """The scene that `join_scenes` returns, and which dense maps it contains."""

    scene: SavedScene
    # For each scene: True if its dense map is in the result, or if it has no dense map. Dense maps
    # with voxels of another size than the first dense map are left out.
    keeps_dense: tuple[bool, ...]


def _renamed(anchor: NDArray[np.int32], uids: IntArray, new_uids: IntArray) -> IntArray:
    rows = np.minimum(np.searchsorted(uids, anchor), len(uids) - 1)
    if len(uids) == 0:
        return np.full(len(anchor), -1)
    return np.where(uids[rows] == anchor, new_uids[rows], -1)


def exported(mapper: SceneMapper, keyframe_uids: IntArray) -> SavedScene:
    """Return the scene that is anchored to saved keyframes with ascending uids (K,)."""
    dense = mapper.dense.export(keyframe_uids)
    anchored = dense.with_anchors(keyframe_uids[dense.anchor]) if len(dense) else None
    return exported_objects(mapper.object_map, keyframe_uids)._replace(dense=anchored)


def exported_objects(objects: ObjectMap | None, keyframe_uids: IntArray) -> SavedScene:
    """Return the objects that are anchored to saved keyframes with ascending uids (K,)."""
    if not objects:
        return SavedScene()
    state, memories = objects.export(keyframe_uids), objects.memories()
    return SavedScene(
        objects=state.with_anchors(keyframe_uids[state.anchor]),
        memories={key: memories[key] for key in state.object_id.tolist()},
    )


def load(mapper: SceneMapper, scene: SavedScene) -> None:
    """Add a scene to a mapper that already has the poses of its anchor keyframes."""
    mapper.correct(mapper.dense.keyframes)
    if scene.objects is not None and mapper.object_map is not None:
        anchors = uids_as_rows(scene.objects.anchor)
        mapper.object_map.load(scene.objects, anchors, scene.memories)
    if scene.dense is not None:
        mapper.load(scene.dense, mapper.dense.keyframes, uids_as_rows(scene.dense.anchor))


def uids_as_rows(anchor: NDArray[np.int32]) -> IntArray:
    return np.arange(1 + int(anchor.max(initial=-1)))


def restored(
    scene: SavedScene, keyframes: KeyframePoses, camera: CameraModel, *, label_cloud: bool = False
) -> SceneMapper:
    """Return the scene mapper of a saved scene; its floor is already searched for.

    If there are several maps, it shows the main one.
    """
    dense = None if scene.dense is None else float(scene.dense.voxel_m[0])
    config = DenseConfig() if dense is None else DenseConfig(voxel_m=dense)
    of_objects = ObjectMapConfig(enabled=True, label_cloud=label_cloud)
    mapper = SceneMapper(camera, config, ObjectTrackerConfig(), of_objects)
    mapper.correct(keyframes)
    load(mapper, scene)
    mapper.grid(mapper.cloud())  # finds the floor
    return mapper


def join_scenes(
    scenes: Sequence[SavedScene], keyframes: KeyframePoses, camera: CameraModel
) -> JoinedScenes:
    dense = [scene.dense for scene in scenes if scene.dense is not None]
    kept = [state for state in dense if state.voxel_m[0] == dense[0].voxel_m[0]]
    keeps_dense = tuple(
        scene.dense is None or any(scene.dense is state for state in kept) for scene in scenes
    )
    objects = ObjectMap(camera)
    objects.correct(keyframes)
    for scene in scenes:
        if scene.objects is not None:
            objects.load(scene.objects, uids_as_rows(scene.objects.anchor), scene.memories)
    objects.join()
    joined = exported_objects(objects, keyframes.uids)
    return JoinedScenes(
        joined._replace(dense=SubmapState.joined(kept) if kept else None), keeps_dense
    )


def write(database: Database, scene: SavedScene) -> None:
    """Replace the scene in a database that has the `TABLES`; MapFileError if this fails."""
    with database.transaction():
        for table in TABLES:
            database.clear(table)
        if scene.dense is not None:
            database.put(SUBMAPS, enumerate(scene.dense.split()))
        if scene.objects is not None:
            database.put(OBJECTS, [(0, scene.objects)])
        database.put(MEMORIES, scene.memories.items())


def add_to_file(path: Path, scene: SavedScene) -> None:
    """Add a scene to a map file that is not in use.

    MapFileError if the file is missing, is no map, or cannot be written.
    """
    with Database.open(path, TABLES) as database:
        write(database, scene)


def read(database: Database) -> SavedScene:
    """Return the scene of a database, which may lack the tables; MapFileError if invalid."""
    submaps = [row[1] for row in database.rows(SUBMAPS)] if database.has(SUBMAPS) else []
    objects = [row[1] for row in database.rows(OBJECTS)] if database.has(OBJECTS) else []
    memories = dict(database.rows(MEMORIES)) if database.has(MEMORIES) else {}
    try:
        with np.errstate(all='ignore'):  # NaN and infinity fail the checks
            for submap in submaps:
                check_submaps(submap)
                is_same = submap.voxel_m[0] == submaps[0].voxel_m[0]
                require(is_same, 'submaps differ in the size of their voxels')
            for state in objects:
                check_objects(state)
            for memory in memories.values():
                check_memory(memory)
    except MapFileError as error:
        raise MapFileError(f'{database.path}: is damaged: {error}') from error
    dense = SubmapState.joined(submaps) if submaps else None
    return SavedScene(dense, objects[0] if objects else None, memories)


def read_file(path: Path) -> SavedScene:
    """Return the scene of a map file after checking it; see `read`."""
    with Database.read(path, TABLES) as database:
        return read(database)
