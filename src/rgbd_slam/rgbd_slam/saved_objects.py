"""Reads the objects of a saved map, as the node that saved it published them."""

from __future__ import annotations

import numpy as np

from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.dense.voxel_map import VoxelMap
from hoid_scene.grid.floor import find_floor
from hoid_scene.level.upright import find_upright
from hoid_scene.level.upright_box import Level
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_map import ObjectMap
from rgbd_slam.store.map_file import MapFile

_UP = np.array([0.0, 0.0, 1.0])
_FLOOR_POINTS = 50_000  # chosen: as many as the scene mapper uses


def saved_objects(content: MapFile) -> tuple[MapObject, ...]:
    """Return the confirmed objects of a map file by id, in its map frame; empty without any.

    If the file contains several maps, only objects of the one with most keyframes are returned.
    The boxes of furniture reach down to the floor of the dense map, if there is one.
    """
    if content.objects is None:
        return ()
    state, uids = content.map, np.arange(len(content.map))
    map_ids = state.map_id.astype(np.int64)
    main_map = int(np.bincount(map_ids).argmax())
    keyframes = KeyframePoses(1, uids, map_ids, main_map, state.T_map_camera)
    objects = ObjectMap(content.camera)
    objects.correct(keyframes)
    objects.load(content.objects, uids)
    if not isinstance(content.dense, SubmapState):
        return objects.objects()
    config = DenseConfig(voxel_m=float(content.dense.voxel_m[0]))
    voxels = VoxelMap(content.camera, config)
    voxels.load(content.dense, keyframes, keyframes.uids)
    points_m = voxels.cloud().points_m.astype(np.float64)
    upright = find_upright(points_m, keyframes.T_map_camera[keyframes.is_main])
    level = Level(_UP) if upright is None else Level(upright.up, upright.wall)
    points_m = points_m[:: max(1, len(points_m) // _FLOOR_POINTS)]
    return objects.objects(find_floor(points_m, level.up), level)
