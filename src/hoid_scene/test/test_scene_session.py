"""The scene follows the sessions of the SLAM node, and survives the death of either node."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import InputError, MapFileError
from hoid_common.poses.keyframe_poses import (
    NO_KEYFRAMES,
    KeyframePoses,
    LoadedKeyframes,
    SessionKeyframes,
)
from hoid_common.store.database import SUFFIX, Database
from hoid_common.store.table import Table
from hoid_common.values import CameraModel, Float32Array, FloatArray
from hoid_scene.config.scene_config import SceneConfig
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.scene_session import SceneSession
from hoid_scene.store.scene_store import SceneStore

from . import object_world
from .object_world import ObjectWorld
from .test_object_map import BOOK, CUP, TABLE

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
WALL_M = np.full((120, 160), 2.01, np.float32)
COLORS = np.zeros((120, 160, 3), np.uint8)
OF_SLAM = Table('keyframes', 'uid', {'stamp_ns': int})


class Process:
    """A scene node without ROS."""

    def __init__(self, folder: Path, **config: object) -> None:
        self.begun: list[str] = []
        self.store = SceneStore(folder / f'store{SUFFIX}', 'hoid_scene')
        self.session = SceneSession(
            SceneConfig().updated(config),
            self.store,
            lambda known: self.begun.append(known.session),
        )

    def map(self, known: SessionKeyframes, times: int = 3) -> None:
        """Fuse images of a wall in front of the newest keyframe."""
        self.session.update(known)
        poses = known.keyframes
        request = SceneRequest(1, poses.T_map_camera[-1], int(poses.uids[-1]), poses)
        for _ in range(times):
            self.mapper.fuse(request, WALL_M, COLORS, ())

    @property
    def mapper(self) -> SceneMapper:
        assert self.session.mapper is not None
        return self.session.mapper

    @property
    def points_m(self) -> Float32Array:
        return self.mapper.cloud().points_m

    def kill(self) -> None:
        """End the process without a word; the store is as a killed process leaves it."""
        self.store._lock.release()


def forward(z_m: float) -> FloatArray:
    return se3.exp(np.array([0, 0, 0, 0, 0, z_m]))


def known(
    session: str, *uids: int, loaded: LoadedKeyframes | None = None, version: int = 1
) -> SessionKeyframes:
    poses = np.array([forward(0.01 * n) for n in range(len(uids))]).reshape(-1, 4, 4)
    keyframes = KeyframePoses(
        version, np.array(uids, np.int64), np.zeros(len(uids), int), 0, poses
    )
    return SessionKeyframes(session, CAMERA, True, keyframes, loaded or LoadedKeyframes())


def test_a_scene_begins_when_the_camera_of_a_session_is_known(tmp_path: Path) -> None:
    process = Process(tmp_path)
    process.session.update(known('', 0)._replace(camera=None))
    assert process.session.mapper is None
    process.map(known('a', 0, 1))
    assert len(process.points_m) > 1000
    process.session.update(known('b', 0))
    assert len(process.points_m) == 0
    assert process.begun == ['', 'a', 'b']


def test_a_scene_is_level_once_gravity_is_known(tmp_path: Path) -> None:
    process = Process(tmp_path)
    process.map(known('a', 0)._replace(is_level=False))
    assert not process.mapper.is_map_level
    process.session.update(known('a', 0, 1, version=2))
    assert process.mapper.is_map_level
    assert len(process.points_m) > 1000


def test_a_killed_scene_node_restores_the_scene_of_the_session(tmp_path: Path) -> None:
    first = Process(tmp_path)
    first.map(known('a', 0))
    first.map(known('a', 0, 4))
    before_m = first.points_m
    first.kill()
    second = Process(tmp_path)
    second.session.update(known('a', 0, 4))
    np.testing.assert_array_equal(second.points_m, before_m)
    second.kill()
    third = Process(tmp_path)
    third.session.update(known('b', 0, 4))
    assert len(third.points_m) == 0


def test_a_killed_slam_node_continues_the_scene_under_other_uids(tmp_path: Path) -> None:
    process = Process(tmp_path)
    for n in range(3):
        process.map(known('a', *range(n + 1)))
    of_two = len(process.mapper.dense.views)
    resumed = LoadedKeyframes(1, 'a', np.array([0, 1]), np.array([10, 11]))
    process.session.update(known('b', 10, 11, loaded=resumed))
    assert [v.keyframe_uid for v in process.mapper.dense.views] == [10] * 3 + [11] * 3
    assert of_two == 9  # the images of a keyframe that the checkpoint lacks are left out
    before_m = process.points_m
    assert len(before_m) > 1000
    process.kill()
    again = Process(tmp_path)
    again.session.update(known('b', 10, 11, loaded=resumed))
    np.testing.assert_array_equal(again.points_m, before_m)


def saved(process: Process, path: Path, keyframes: SessionKeyframes) -> str:
    Database.create(path, [OF_SLAM]).close()
    return process.session.add_to_map(path, keyframes)


def test_the_scene_is_saved_with_a_map_and_loaded_with_it_once(tmp_path: Path) -> None:
    process, path = Process(tmp_path), tmp_path / f'room{SUFFIX}'
    process.map(known('a', 5, 6))
    before_m = process.points_m
    assert saved(process, path, known('a', 5, 6)).endswith('voxels of the dense map')
    loaded = LoadedKeyframes(1, str(path), np.array([5, 6]), np.array([0, 1]))
    process.session.update(known('b', 0, 1, loaded=loaded))
    after_m = process.points_m
    np.testing.assert_allclose(after_m, before_m, atol=2e-4)
    process.session.update(known('b', 0, 1, loaded=loaded, version=2))
    assert len(process.points_m) == len(after_m)
    path.unlink()  # it is in the store
    process.kill()
    again = Process(tmp_path)
    again.session.update(known('b', 0, 1, loaded=loaded))
    np.testing.assert_allclose(again.points_m, after_m, atol=2e-4)


def test_a_scene_that_does_not_fit_is_left_out_and_reported(tmp_path: Path) -> None:
    process, path = Process(tmp_path), tmp_path / f'room{SUFFIX}'
    process.map(known('a', 5))
    saved(process, path, known('a', 5))
    process.kill()
    coarse = Process(tmp_path / 'other', **{'dense.voxel_m': 0.05})
    loaded = LoadedKeyframes(1, str(path), np.array([5]), np.array([0]))
    coarse.session.update(known('b', 0, loaded=loaded))
    assert len(coarse.points_m) == 0
    assert 'is left out: the dense map was made with dense.voxel_m 0.025' in coarse.session.problem
    coarse.session.update(known('c', 0))
    assert coarse.session.problem == ''


def test_keyframes_of_another_session_are_not_saved(tmp_path: Path) -> None:
    process, path = Process(tmp_path), tmp_path / f'room{SUFFIX}'
    process.map(known('a', 5))
    with pytest.raises(InputError, match='have not arrived'):
        saved(process, path, known('b', 5))


@pytest.mark.parametrize('is_level', [False, True])
def test_before_the_first_keyframe_there_is_no_grid(tmp_path: Path, *, is_level: bool) -> None:
    process = Process(tmp_path)
    process.session.update(SessionKeyframes('a', CAMERA, is_level, NO_KEYFRAMES))
    assert process.mapper.grid(process.mapper.cloud()) is None


def test_two_nodes_cannot_have_one_store(tmp_path: Path) -> None:
    first = Process(tmp_path)
    with pytest.raises(MapFileError, match='another hoid_scene runs already'):
        Process(tmp_path)
    first.store.close(keep=False)
    assert [path.suffix for path in tmp_path.iterdir()] == ['.lock']
    Process(tmp_path)


def test_a_damaged_store_is_replaced(tmp_path: Path) -> None:
    first = Process(tmp_path)
    first.map(known('a', 0))
    first.store.close(keep=True)
    path = tmp_path / f'store{SUFFIX}'
    path.write_bytes(path.read_bytes()[:20_000])
    second = Process(tmp_path)
    second.session.update(known('a', 0))
    assert len(second.points_m) == 0


def test_a_scene_whose_store_cannot_be_written_is_mapped_all_the_same(tmp_path: Path) -> None:
    """As after a reset on a full disk. A folder has the name of the store here."""
    (tmp_path / f'store{SUFFIX}').mkdir()
    process = Process(tmp_path, **{'object_map.enabled': True})
    process.map(known('a', 3, 4))
    assert 'a crash would lose the scene, which cannot be stored: ' in process.session.problem
    assert len(process.points_m) > 100
    process.session.store_objects()
    (tmp_path / f'store{SUFFIX}').rmdir()
    process.map(known('b', 5, 6))
    assert process.session.problem == ''
    assert process.store.session is not None


def with_objects(process: Process, known: SessionKeyframes) -> ObjectWorld:
    """Return a world that the object map of a process looks at, after an update."""
    process.session.update(known._replace(camera=object_world.CAMERA))
    world = ObjectWorld()
    assert process.mapper.object_map is not None
    world.map, world.keyframes = process.mapper.object_map, known.keyframes
    return world


def test_a_killed_node_restores_which_objects_are_new_since_a_map_was_loaded(
    tmp_path: Path,
) -> None:
    config = {'object_map.enabled': True}
    process, path = Process(tmp_path, **config), tmp_path / f'room{SUFFIX}'
    with_objects(process, known('a', 0)).look(TABLE, CUP, times=6)
    saved(process, path, known('a', 0))
    loaded = LoadedKeyframes(1, str(path), np.array([0]), np.array([0]))
    process.session.update(known('b', 0, loaded=loaded)._replace(camera=object_world.CAMERA))
    process.kill()  # before the objects are stored by the timer
    second = Process(tmp_path, **config)
    world = with_objects(second, known('b', 0, loaded=loaded))
    (cup,) = world.map.objects()
    assert (cup.class_name, cup.is_new) == ('cup', False)
    world.stamp_ns = 3600 * 10**9
    before = world.look(TABLE, CUP, BOOK, times=8)
    assert [(item.class_name, item.is_new) for item in before] == [('cup', False), ('book', True)]
    second.session.store_objects()
    second.kill()
    world = with_objects(Process(tmp_path, **config), known('b', 0, loaded=loaded))
    after = world.map.objects()
    assert [(item.class_name, item.is_new) for item in after] == [('cup', False), ('book', True)]
    assert [item.events for item in after] == [item.events for item in before]


def test_a_killed_node_without_a_loaded_map_has_no_new_objects(tmp_path: Path) -> None:
    config = {'object_map.enabled': True}
    process = Process(tmp_path, **config)
    with_objects(process, known('a', 0)).look(TABLE, CUP, times=6)
    process.session.store_objects()
    process.kill()
    world = with_objects(Process(tmp_path, **config), known('a', 0))
    after = world.look(TABLE, CUP, BOOK, times=8)
    assert [(item.class_name, item.is_new) for item in after] == [('cup', False), ('book', False)]


def test_only_memories_that_have_changed_are_stored_again(tmp_path: Path) -> None:
    process = Process(tmp_path, **{'object_map.enabled': True})
    world = with_objects(process, known('a', 0))
    world.color = np.full((480, 640, 3), 90, np.uint8)
    world.look(TABLE, CUP, BOOK, times=6)
    process.session.store_objects()
    book = next(item for item in world.map.objects() if item.class_name == 'book')
    world.map.forget(book.object_id)
    process.session.store_objects()
    assert [memory.jpeg.size > 0 for memory in process.store.loaded().memories.values()] == [True]
    process.kill()
    again = with_objects(Process(tmp_path, **{'object_map.enabled': True}), known('a', 0))
    assert [item.colors for item in again.map.objects()] == [('gray',)]
