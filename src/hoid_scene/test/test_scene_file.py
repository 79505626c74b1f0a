"""A saved scene comes back, is joined with others, and is refused if it breaks a rule."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.store.database import SUFFIX, Database
from hoid_common.store.table import Table
from hoid_common.values import CameraModel, Float32Array, FloatArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.dense_map import DenseMap
from hoid_scene.dense.fusion import PosedView
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.place import Anchor
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import SavedScene, join_scenes

from .object_world import Box, ObjectWorld

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
OF_SLAM = Table('keyframes', 'uid', {'stamp_ns': int})
SHIFT = se3.exp(np.array([0.0, 0.3, 0.0, 0.2, 0.05, 0.1]))


def keyframes(uids: list[int], poses: list[FloatArray]) -> KeyframePoses:
    return KeyframePoses(1, np.array(uids), np.zeros(len(uids), np.int64), 0, np.array(poses))


def wall(uid: int, T: FloatArray, voxel_m: float = 0.025) -> SubmapState:
    """Return a wall 2 m in front of a keyframe, whose anchors are its uid."""
    voxels = DenseMap(CAMERA, DenseConfig(voxel_m=voxel_m))
    shape = CAMERA.height_px, CAMERA.width_px
    view = voxels.camera.view_of(
        np.full(shape, 2.0, np.float32), np.zeros(shape, bool), np.zeros((*shape, 3), np.uint8)
    )
    for slot in range(3):
        voxels.integrate(PosedView(view, slot, Anchor(uid, 0, T, T)))
    state = voxels.export(np.array([uid]))
    return state.with_anchors(np.full(len(state.anchor), uid))


def cloud_m(scene: SavedScene, known: KeyframePoses) -> Float32Array:
    assert scene.dense is not None
    voxels = DenseMap(CAMERA, DenseConfig())
    voxels.correct(known)
    voxels.load(scene.dense, scene_file.uids_as_rows(scene.dense.anchor))
    return voxels.cloud().points_m


def objects() -> ObjectMapState:
    """Return two objects that were seen from the first keyframe."""
    world = ObjectWorld()
    cup = Box('cup', (1.9, 0.3, -0.45), (2.0, 0.4, -0.3))
    vase = Box('vase', (1.9, -0.5, -0.45), (2.05, -0.35, -0.1))
    world.look(cup, vase, times=4)
    return world.map.export(np.array([0]))


def saved(path: Path, scene: SavedScene) -> Path:
    """Add a scene to a map file of the SLAM node, and return its path."""
    with Database.create(path, [OF_SLAM]) as database:
        database.put(OF_SLAM, [(7, 1)])
    scene_file.add_to_file(path, scene)
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / f'room{SUFFIX}'


def test_a_scene_is_added_to_a_map_file_and_comes_back(path: Path) -> None:
    scene = SavedScene(wall(7, np.eye(4)), objects())
    back = scene_file.read_file(saved(path, scene))
    assert scene.dense is not None
    assert scene.objects is not None
    assert back.dense is not None
    assert back.objects is not None
    assert back.dense.digest() == scene.dense.digest()
    assert back.objects.digest() == scene.objects.digest()
    assert back.summary == f'{len(scene.dense)} voxels of the dense map, 2 objects'
    with Database.read(path, [OF_SLAM]) as database:
        assert list(database.rows(OF_SLAM)) == [(7, 1)]
    scene_file.add_to_file(path, SavedScene())
    assert scene_file.read_file(path).summary == '0 voxels of the dense map'


def test_a_map_file_without_a_scene_has_an_empty_one(path: Path) -> None:
    Database.create(path, [OF_SLAM]).close()
    assert scene_file.read_file(path) == SavedScene()


def test_anchors_get_the_uids_of_another_session_and_others_are_left_out() -> None:
    scene = SavedScene(SubmapState.joined([wall(7, np.eye(4)), wall(9, SHIFT)]), objects())
    renamed = scene.renamed(np.array([0, 7]), np.array([20, 30]))
    assert renamed.dense is not None
    assert renamed.objects is not None
    assert set(renamed.dense.anchor.tolist()) == {30}
    assert set(renamed.objects.anchor.tolist()) == {20}
    nothing = scene.renamed(np.empty(0, np.int64), np.empty(0, np.int64))
    assert nothing.summary == '0 voxels of the dense map, 0 objects'


def test_a_joined_scene_has_the_dense_maps_of_both_where_they_were_seen() -> None:
    known = keyframes([3, 8], [np.eye(4), SHIFT])
    one, other = SavedScene(wall(3, np.eye(4))), SavedScene(wall(8, SHIFT))
    joined = join_scenes([one, other], known, CAMERA)
    assert joined.keeps_dense == (True, True)
    expected_m = np.concatenate([cloud_m(one, known), cloud_m(other, known)])
    points_m = cloud_m(joined.scene, known)
    assert len(points_m) == len(expected_m) > 2000
    assert np.linalg.norm(points_m - expected_m, axis=1).max() < 1e-6


def test_voxels_of_another_size_are_left_out_and_reported() -> None:
    known = keyframes([3, 8], [np.eye(4), SHIFT])
    one, other = SavedScene(wall(3, np.eye(4))), SavedScene(wall(8, SHIFT, voxel_m=0.05))
    joined = join_scenes([one, other], known, CAMERA)
    assert joined.keeps_dense == (True, False)
    np.testing.assert_array_equal(cloud_m(joined.scene, known), cloud_m(one, known))


def test_submaps_with_voxels_of_different_sizes_are_refused(path: Path) -> None:
    with Database.create(path, scene_file.TABLES) as database:
        walls = wall(3, np.eye(4)).split()[0], wall(3, np.eye(4), voxel_m=0.05).split()[0]
        database.put(scene_file.SUBMAPS, enumerate(walls))
    with pytest.raises(MapFileError, match=r'room\.hoidmap: is damaged: submaps differ'):
        scene_file.read_file(path)


OBJECT_FAULTS: dict[str, tuple[str, dict[str, Any]]] = {
    'number': ("object's number is invalid", {'object_id': np.array([1, 99])}),
    'numbers': ('same number', {'object_id': np.array([1, 1])}),
    'pose': ('pose is invalid', {'T_anchor_object': np.full((2, 4, 4), np.nan)}),
    'state': ('state is unknown', {'left_as': np.array([0, 4], np.uint8)}),
    'sightings': ('num_sightings', {'num_sightings': np.array([4, 0])}),
    'stamp': ('stamp is out of range', {'last_ns': np.array([-1, 0])}),
    'probability': ('probability', {'probability': np.array([0.5, np.nan])}),
    'direction': ('invalid vector', {'direction_m': np.full((2, 3), np.inf)}),
    'classes': ('do not add up', {'num_classes': np.array([1, 2], np.int32)}),
    'no class': ('no class', {'num_classes': np.array([0, 2], np.int32)}),
    'name': ('name of a class', {'class_name': np.full((2, 64), 255, np.uint8)}),
    'empty name': ('name of a class', {'class_name': np.zeros((2, 64), np.uint8)}),
    'line break': ('name of a class', {'class_name': np.full((2, 64), 10, np.uint8)}),
    'score': ('score is invalid', {'class_score': np.array([0.0, 1.0])}),
    'voxels': ('numbers of voxels', {'num_voxels': np.array([1, 1], np.int32)}),
}


@pytest.mark.parametrize('name', OBJECT_FAULTS)
def test_objects_that_break_a_rule_are_refused(path: Path, name: str) -> None:
    said, columns = OBJECT_FAULTS[name]
    saved(path, SavedScene(None, replace(objects(), **columns)))
    with pytest.raises(MapFileError, match=said):
        scene_file.read_file(path)


def test_unsorted_or_far_voxels_of_objects_are_refused(path: Path) -> None:
    valid = objects()
    faults: list[tuple[str, Any, str]] = [
        ('key', valid.key[::-1].copy(), 'not sorted'),
        ('key', valid.key - 2**30, 'too far'),
    ]
    for name, said in (('readings', 'readings'), ('hits', 'evidence'), ('means_m', 'point of')):
        faults.append((name, np.full_like(getattr(valid, name), np.nan), said))
    for n, (name, values, said) in enumerate(faults):
        broken = path.with_name(f'{n}{SUFFIX}')
        saved(broken, SavedScene(None, replace(valid, **{name: values})))
        with pytest.raises(MapFileError, match=said):
            scene_file.read_file(broken)
