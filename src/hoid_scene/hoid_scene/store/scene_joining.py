"""Joins the scenes of saved maps that have become one map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import CameraModel
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.store.scene_file import SavedScene, uids_as_rows


class JoinedScenes(NamedTuple):
    """The scene that `join_scenes` has made of several scenes."""

    scene: SavedScene
    # For each scene: True if its dense map is in the result, or if it has no dense map. Dense maps
    # with voxels of another size than the first dense map are left out.
    keeps_dense: tuple[bool, ...]


def join_scenes(
    scenes: Sequence[SavedScene], keyframes: KeyframePoses, camera: CameraModel
) -> JoinedScenes:
    """Return one scene, in which the same object of several maps is one.

    Args:
        scenes: The scenes, whose anchors are uids of the joined map.
        keyframes: All keyframes of the joined map.
        camera: The camera that the first map was made with.
    """
    dense = [scene.dense for scene in scenes if scene.dense is not None]
    kept = [state for state in dense if state.voxel_m[0] == dense[0].voxel_m[0]]
    keeps_dense = tuple(
        scene.dense is None or any(scene.dense is state for state in kept) for scene in scenes
    )
    objects = ObjectMap(camera)
    objects.correct(keyframes)
    for scene in scenes:
        if scene.objects is not None:
            objects.load(scene.objects, uids_as_rows(scene.objects.anchor))
    objects.join()
    found = objects.export(keyframes.uids) if len(objects) else None
    joined = SavedScene(SubmapState.joined(kept) if kept else None)
    if found is not None:
        joined = joined._replace(objects=found.with_anchors(keyframes.uids[found.anchor]))
    return JoinedScenes(joined, keeps_dense)
