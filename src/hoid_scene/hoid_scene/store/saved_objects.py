"""Reads the objects of a saved map, as the node that saved it published them."""

from __future__ import annotations

from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import CameraModel
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.config.object_map_config import ObjectMapConfig
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import SavedScene


def saved_objects(
    scene: SavedScene, keyframes: KeyframePoses, camera: CameraModel
) -> tuple[MapObject, ...]:
    """Return the confirmed objects of a saved scene by id; empty without any.

    If there are several maps, only objects of the main one are returned. The boxes of furniture
    reach down to the floor of the dense map, if there is one.

    Args:
        scene: The scene.
        keyframes: The saved keyframes.
        camera: The camera that the map was made with.
    """
    dense = None if scene.dense is None else float(scene.dense.voxel_m[0])
    config = DenseConfig() if dense is None else DenseConfig(voxel_m=dense)
    mapper = SceneMapper(camera, config, ObjectTrackerConfig(), ObjectMapConfig(enabled=True))
    mapper.correct(keyframes)
    scene_file.load(mapper, scene)
    mapper.grid(mapper.cloud())  # finds the floor
    return mapper.mapped_objects()
