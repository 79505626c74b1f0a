"""The dense map in a map file: what comes back, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MapFileError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.store.database import SUFFIX, Database
from hoid_common.values import CameraModel, FloatArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.store import scene_file

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
WALL_M = np.full((120, 160), 2.01, np.float32)
COLORS = np.random.default_rng(1).integers(0, 256, (120, 160, 3), np.uint8)


def keyframes(*uids: int, T_new_old: FloatArray = se3.exp(np.zeros(6))) -> KeyframePoses:  # noqa: B008
    T = np.array([T_new_old @ se3.exp(np.array([0, 0, 0, 0.3 * n, 0, 0])) for n in range(2)])
    return KeyframePoses(1, np.array(uids), np.zeros(2, np.int64), 0, T)


def new_scene(config: DenseConfig | None = None) -> SceneMapper:
    return SceneMapper(CAMERA, config or DenseConfig(), ObjectTrackerConfig())


def fused_scene() -> SceneMapper:
    scene, known = new_scene(), keyframes(0, 1)
    for row in (0, 0, 0, 1, 1, 1):
        scene.fuse(SceneRequest(0, known.T_map_camera[row], row, known), WALL_M, COLORS, ())
    return scene


def saved() -> SubmapState:
    dense = fused_scene().dense
    return dense.export(dense.keyframes.uids)


def test_a_saved_dense_map_comes_back_where_its_keyframes_are_now(tmp_path: Path) -> None:
    before = fused_scene().cloud()
    path = tmp_path / f'a{SUFFIX}'
    with Database.create(path, scene_file.TABLES) as database:
        scene_file.write(database, scene_file.SavedScene(saved()))
    state = scene_file.read_file(path).dense
    assert isinstance(state, SubmapState)
    assert state.digest() == saved().digest()
    T_new_old = se3.exp(np.array([0, 0, 0.5, 1, 2, 3]))
    scene, known = new_scene(), keyframes(7, 9, T_new_old=T_new_old)
    scene.load(state, known, known.uids)
    after = scene.cloud()
    moved = se3.transform(T_new_old, before.points_m.astype(np.float64))
    np.testing.assert_allclose(after.points_m, moved, atol=2e-4)
    np.testing.assert_allclose(after.colors_bgr, before.colors_bgr, atol=1)
    again = scene.dense.export(scene.dense.keyframes.uids)
    assert again.digest() == state.digest()


def test_a_loaded_dense_map_is_carved_and_extended_by_new_images() -> None:
    scene, known = new_scene(), keyframes(0, 1)
    scene.load(saved(), known, known.uids)
    for _ in range(6):  # the wall is gone
        request = SceneRequest(0, known.T_map_camera[0], 0, known)
        scene.fuse(request, WALL_M + 1, COLORS, ())
    in_view = np.abs(scene.cloud().points_m[:, 0]) < 1
    assert (scene.cloud().points_m[in_view, 2] > 2.9).all()


def test_new_images_of_a_loaded_submap_are_fused_again_and_its_voxels_stay() -> None:
    scene, known = new_scene(), keyframes(0, 1)
    scene.load(saved(), known, known.uids)
    of_wall = len(scene.cloud().points_m)
    box_m = np.zeros_like(WALL_M)  # nothing else is measured
    box_m[50:70, 70:90] = 1.51
    for _ in range(6):
        scene.fuse(SceneRequest(0, known.T_map_camera[1], 1, known), box_m, COLORS, ())
    moved = known.T_map_camera.copy()
    moved[1, 2, 3] += 0.1
    scene.dense.correct(known._replace(version=2, T_map_camera=moved), force=True)
    z_m = scene.cloud().points_m[:, 2]
    assert np.count_nonzero(z_m > 1.9) == of_wall
    np.testing.assert_allclose(z_m[z_m < 1.9], 1.61, atol=0.01)
    assert np.count_nonzero(z_m < 1.9) > 20


def test_loaded_voxels_are_on_disk_until_an_image_changes_them() -> None:
    scene, known = new_scene(), keyframes(0, 1)
    scene.load(saved(), known, known.uids)
    assert scene.dense.num_in_memory == 0
    scene.fuse(SceneRequest(0, known.T_map_camera[0], 0, known), WALL_M, COLORS, ())
    assert scene.dense.num_in_memory > 0


def test_the_dense_map_of_other_voxels_is_refused() -> None:
    scene, known = new_scene(DenseConfig(voxel_m=0.05)), keyframes(0, 1)
    with pytest.raises(MapFileError, match=r'dense\.voxel_m'):
        scene.load(saved(), known, known.uids)


@pytest.mark.parametrize(
    ('name', 'value', 'said'),
    [
        ('voxel_m', np.nan, 'size of a voxel'),
        ('anchor', -1, 'has no keyframe'),
        ('T_anchor_submap', np.nan, "submap's pose"),
        ('num_voxels', 0, 'has no voxels'),
        ('num_voxels', 2**31 - 1, 'do not add up'),
        ('key', -1, 'outside of its submap'),
        ('key', 72**3 - 1, 'not sorted'),
        ('weight', 0, 'weight is invalid'),
        ('weight', np.inf, 'weight is invalid'),
    ],
)
def test_voxels_that_form_no_dense_map_are_refused(
    tmp_path: Path, name: str, value: float, said: str
) -> None:
    array = getattr(saved(), name).copy()
    array[0] = value
    path = tmp_path / f'a{SUFFIX}'
    with Database.create(path, scene_file.TABLES) as database:
        database.put(scene_file.SUBMAPS, [(0, replace(saved(), **{name: array}))])
    with pytest.raises(MapFileError, match=said):
        scene_file.read_file(path)
