"""Stored images and voxels follow the corrections of the keyframes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.store.database import SUFFIX, Database
from hoid_common.values import CameraModel, FloatArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.dense_map import DenseMap
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.view_store import IMAGES, VIEWS, StoredView, ViewStore
from hoid_scene.scene_scheduler import SceneRequest

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
CONFIG = DenseConfig()
WALL_M = 2.01  # the depth of a wall, in the middle of a voxel
VIEW = DepthView(np.full((60, 80), 1000 * WALL_M, np.uint16), np.zeros((30, 40, 3), np.uint8))


class Bench:
    """A dense map, fed with images of a wall."""

    def __init__(self, store: ViewStore | None = None) -> None:
        self.voxels = DenseMap(CAMERA, CONFIG, store)

    @property
    def z_m(self) -> FloatArray:
        """Return z of all shown points, rounded to millimeters, each value once."""
        return np.unique(self.voxels.cloud().points_m[:, 2].round(3))

    def add(self, known: KeyframePoses, count: int = 1, uid: int | None = None) -> None:
        """Add images that were taken at the origin, of the newest keyframe or of another one."""
        uid = int(known.uids[-1]) if uid is None else uid
        for _ in range(count):
            self.voxels.add(SceneRequest(0, np.eye(4), uid, known), VIEW)


def keyframes(
    *uids: int, z_m: float | list[float] = 0.0, map_id: int = 0, version: int = 1
) -> KeyframePoses:
    z = np.broadcast_to(z_m, len(uids))
    T = np.array([forward(value) for value in z])
    return KeyframePoses(version, np.array(uids, np.int64), np.full(len(uids), map_id), 0, T)


def forward(z_m: float) -> FloatArray:
    return se3.exp(np.array([0, 0, 0, 0, 0, z_m]))


def test_images_are_fused_at_their_poses() -> None:
    bench = Bench()
    for _ in range(3):
        bench.voxels.add(SceneRequest(0, forward(0.5), 0, keyframes(0, z_m=0.2)), VIEW)
    assert bench.z_m == pytest.approx([0.5 + WALL_M], abs=0.002)


def test_a_correction_moves_all_voxels_with_their_keyframes() -> None:
    bench = Bench()
    bench.add(keyframes(0, 1, 2), 3)
    before = bench.voxels.cloud()
    assert not bench.voxels.correct(keyframes(0, 1, 2, z_m=0.5))
    after = bench.voxels.cloud()
    np.testing.assert_allclose(after.points_m, before.points_m + np.array([0, 0, 0.5]), atol=1e-5)
    assert not bench.voxels.fuse_bent()


def test_a_bent_submap_is_fused_again() -> None:
    bench = Bench()
    bench.add(keyframes(0, 1), 3, uid=0)
    bench.add(keyframes(0, 1), 3, uid=1)
    assert bench.voxels.correct(keyframes(0, 1, z_m=[0.0, 0.1]))
    assert bench.z_m == pytest.approx([WALL_M], abs=0.002)  # rigid until it is fused again
    while bench.voxels.fuse_bent():
        pass
    assert bench.voxels.num_bent == 0
    # The newer images see through what the older ones measured, but for its margin.
    assert bench.z_m == pytest.approx([WALL_M, WALL_M + 0.1], abs=0.002)
    assert np.mean(bench.voxels.cloud().points_m[:, 2] > WALL_M + 0.05) > 0.9


def test_small_bends_stay_unless_forced() -> None:
    bench = Bench()
    bench.add(keyframes(0, 1), 3, uid=0)
    bench.add(keyframes(0, 1), 3, uid=1)
    bent = keyframes(0, 1, z_m=[0.0, 0.01])
    assert not bench.voxels.correct(bent)
    assert bench.z_m == pytest.approx([WALL_M], abs=0.002)
    assert bench.voxels.correct(bent, force=True)
    assert bench.z_m == pytest.approx([WALL_M + 0.005], abs=0.002)


def test_a_forced_correction_leaves_no_bent_submap_in_any_map() -> None:
    bench = Bench()
    known = keyframes(0, 1, 2, 3)._replace(map_ids=np.array([0, 0, 1, 1]))
    for uid in known.uids.tolist():
        bench.add(known, 3, uid)
    bent = keyframes(0, 1, 2, 3, z_m=[0.0, 0.1, 0.0, 0.1])._replace(map_ids=known.map_ids)
    assert bench.voxels.correct(bent)
    assert {submap.place.map_id for submap in bench.voxels.submaps if submap.is_bent} == {0, 1}
    assert bench.voxels.correct(bent, force=True)
    assert bench.voxels.num_bent == 0


def test_images_and_submaps_of_a_removed_keyframe_move_with_another_one() -> None:
    bench = Bench()
    for i in range(4):
        bench.add(keyframes(*range(i + 1)))
    bench.voxels.correct(keyframes(1, 3))
    bench.voxels.correct(keyframes(1, 3, z_m=1.0))
    assert bench.z_m == pytest.approx([1 + WALL_M], abs=0.002)
    assert {view.keyframe_uid for view in bench.voxels.views} == {1, 3}


def test_a_removed_map_takes_its_images_and_voxels_along() -> None:
    bench = Bench()
    bench.add(keyframes(0), 4)
    bench.voxels.correct(keyframes(100))
    assert not bench.voxels.views
    assert len(bench.voxels) == 0


def test_voxels_of_another_map_are_shown_once_it_is_merged() -> None:
    bench = Bench()
    bench.add(keyframes(0, map_id=1), 4)
    assert len(bench.voxels.cloud().points_m) == 0
    bench.voxels.correct(keyframes(0, z_m=1.0))
    assert bench.z_m == pytest.approx([1 + WALL_M], abs=0.002)
    bench.voxels.correct(keyframes(0, map_id=1))
    assert len(bench.voxels.cloud().points_m) == 0


def test_a_late_request_is_fused_at_the_corrected_pose() -> None:
    bench = Bench()
    bench.voxels.correct(keyframes(0, 1, z_m=1.0, version=2))
    bench.add(keyframes(0), 3)
    assert bench.z_m == pytest.approx([1 + WALL_M], abs=0.002)


def stored(path: Path) -> ViewStore:
    """Return the store in a file, which is made if it is missing."""
    tables = VIEWS, IMAGES
    return ViewStore((Database.open if path.exists() else Database.start)(path, tables))


def test_a_killed_process_leaves_images_that_restore_the_voxels(tmp_path: Path) -> None:
    path = tmp_path / f'views{SUFFIX}'
    bench = Bench(stored(path))
    for i in range(4):
        bench.add(keyframes(*range(i + 1)))
    bench.voxels.correct(keyframes(0, 1, 3))  # the image of keyframe 2 moves to another one

    successor = Bench(stored(path))
    successor.voxels.correct(keyframes(0, 1, 3))
    successor.voxels.restore()
    np.testing.assert_array_equal(successor.voxels.cloud().points_m, bench.voxels.cloud().points_m)
    assert [v.keyframe_uid for v in successor.voxels.views] == [0, 1, 1, 3]
    images = [successor.voxels.read(slot) for slot in range(4)]
    assert all(i is not None and (i.flagged_mm == VIEW.flagged_mm).all() for i in images)
    successor.add(keyframes(0, 1, 3))
    assert successor.voxels.read(4) is not None  # slots are not used twice

    last = Bench(stored(path))
    last.voxels.correct(keyframes(0, 3))  # keyframe 1 is gone, with its images
    last.voxels.restore()
    assert [v.keyframe_uid for v in last.voxels.views] == [0, 3, 3]
    assert [slot for slot, _ in stored(path).views()] == [0, 3, 4]


def test_the_most_different_poses_are_kept_at_one_place(tmp_path: Path) -> None:
    store = stored(tmp_path / f'views{SUFFIX}')
    bench = Bench(store)
    for i in range(130):
        pose = forward(0.1 * (i // 26))  # 26 images at each of five poses
        bench.voxels.add(SceneRequest(i, pose, 0, keyframes(0)), VIEW)
    assert len(bench.voxels.views) == len(list(store.views())) == 100
    z_m = [round(float(view.T_keyframe_camera[2, 3]), 6) for view in bench.voxels.views]
    assert set(z_m) == {0, 0.1, 0.2, 0.3, 0.4}
    bench.voxels.clear()
    assert list(store.views()) == []


def test_a_temporary_store_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    store = ViewStore.temporary()
    assert not list(tmp_path.iterdir())
    store.put(7, StoredView(3, forward(1.0)), VIEW)
    np.testing.assert_array_equal(store.read(7).image_bgr, VIEW.image_bgr)
    ((slot, view),) = store.views()
    assert (slot, view.keyframe_uid) == (7, 3)
    np.testing.assert_array_equal(view.T_keyframe_camera, forward(1.0))
