"""The ledger of stored images: consumers follow the corrections of the keyframes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.scene_ledger import SceneLedger
from rgbd_slam.scene.scene_scheduler import SceneRequest
from rgbd_slam.scene.stored_view import ViewCopies
from rgbd_slam.scene.voxel_map import DepthView

CONFIG = DenseConfig()
VIEW = DepthView(np.full((6, 8), 2000, np.uint16), np.zeros((6, 8, 3), np.uint8))


class Poses:
    """A consumer that keeps the z coordinate [m] of each integrated camera pose."""

    def __init__(self) -> None:
        self.z_m: list[float] = []

    def integrate(self, view: DepthView, T_map_camera: FloatArray) -> None:
        assert view is VIEW
        self.z_m.append(float(T_map_camera[2, 3]))

    def clear(self) -> None:
        self.z_m.clear()


class Bench:
    """A ledger with two consumers, which must always be equal."""

    def __init__(self, config: DenseConfig = CONFIG) -> None:
        self.consumers = Poses(), Poses()
        self.ledger = SceneLedger(self.consumers, config)

    @property
    def z_m(self) -> list[float]:
        first, second = self.consumers
        assert first.z_m == second.z_m
        return first.z_m


def keyframes(*uids: int, z_m: float = 0.0, map_id: int = 0, version: int = 1) -> KeyframePoses:
    map_ids = np.full(len(uids), map_id)
    T = np.array([forward(z_m)] * len(uids))
    return KeyframePoses(version, np.array(uids, np.int64), map_ids, 0, T)


def forward(z_m: float) -> FloatArray:
    return se3.exp(np.array([0, 0, 0, 0, 0, z_m]))


def add(ledger: SceneLedger, known: KeyframePoses, count: int = 1) -> None:
    for _ in range(count):
        ledger.add(SceneRequest(0, np.eye(4), int(known.uids[-1]), known), VIEW)


def test_all_consumers_integrate_an_image_once_at_its_pose() -> None:
    bench = Bench()
    request = SceneRequest(0, forward(0.5), 0, keyframes(0, z_m=0.2))
    bench.ledger.add(request, VIEW)
    np.testing.assert_allclose(bench.z_m, [0.5])
    ((view, T_map_camera),) = bench.ledger.integrated()
    assert view is VIEW
    np.testing.assert_allclose(T_map_camera, forward(0.5), atol=1e-12)


def test_a_large_correction_rebuilds_all_consumers() -> None:
    bench = Bench()
    for i in range(3):
        add(bench.ledger, keyframes(*range(i + 1)))
    assert not bench.ledger.correct(keyframes(0, 1, 2))
    assert bench.ledger.correct(keyframes(0, 1, 2, z_m=0.5))
    np.testing.assert_allclose(bench.z_m, [0.5] * 3)


def test_small_corrections_wait_unless_forced() -> None:
    bench = Bench()
    add(bench.ledger, keyframes(0), 4)
    moved = keyframes(0, z_m=0.02)
    assert not bench.ledger.correct(moved)
    assert bench.z_m == [0.0] * 4
    assert bench.ledger.correct(moved, force=True)
    np.testing.assert_allclose(bench.z_m, [0.02] * 4)


def test_images_of_a_removed_keyframe_are_attached_to_another_one() -> None:
    bench = Bench()
    for i in range(4):
        add(bench.ledger, keyframes(*range(i + 1)))
    bench.ledger.correct(keyframes(0, 3))
    assert bench.ledger.correct(keyframes(0, 3, z_m=1.0))
    np.testing.assert_allclose(bench.z_m, [1.0] * 4)
    assert {view.keyframe_uid for view in bench.ledger.views} == {0, 3}


def test_images_of_a_removed_map_are_removed() -> None:
    bench = Bench()
    add(bench.ledger, keyframes(0), 4)
    bench.ledger.correct(keyframes(100), force=True)
    assert not bench.ledger.views
    assert bench.z_m == []


def test_images_of_another_map_wait_until_it_is_merged() -> None:
    bench = Bench()
    add(bench.ledger, keyframes(0, map_id=1), 4)
    assert len(bench.ledger.views) == 4
    assert bench.z_m == []
    assert bench.ledger.correct(keyframes(0, z_m=1.0))
    np.testing.assert_allclose(bench.z_m, [1.0] * 4)
    assert bench.ledger.correct(keyframes(0, map_id=1))
    assert bench.z_m == []


def test_a_late_request_is_integrated_at_the_corrected_pose() -> None:
    bench = Bench()
    bench.ledger.correct(keyframes(0, 1, z_m=1.0, version=2))
    add(bench.ledger, keyframes(0), 3)
    np.testing.assert_allclose(bench.z_m, [1.0] * 3)


def test_stored_images_restore_the_consumers() -> None:
    first, second = Bench(), Bench()
    for i in range(3):
        add(first.ledger, keyframes(*range(i + 1)))
    second.ledger.correct(keyframes(0, 1, 2))
    for view in first.ledger.views:
        second.ledger.restore(view)
    assert second.z_m == first.z_m
    second.ledger.restore(replace(first.ledger.views[0], keyframe_uid=99))
    assert len(second.ledger.views) == 3


def test_the_most_different_poses_are_kept() -> None:
    bench = Bench(DenseConfig(max_views=5))
    for i in range(20):
        pose = forward(0.1 * (i // 4))  # four images at each of five poses
        bench.ledger.add(SceneRequest(i, pose, 0, keyframes(0)), VIEW)
    bench.ledger.correct(keyframes(0), force=True)
    np.testing.assert_allclose(np.unique(np.round(bench.z_m, 6)), [0, 0.1, 0.2, 0.3, 0.4])


def test_copies_follow_the_changes_and_restore_another_ledger() -> None:
    bench, copies = Bench(DenseConfig(max_views=3)), ViewCopies()
    for i in range(4):
        add(bench.ledger, keyframes(*range(i + 1)))
        for change in bench.ledger.take_changes():
            copies.apply(change)
    bench.ledger.correct(keyframes(0, 3))
    for change in bench.ledger.take_changes():
        copies.apply(change)
    copied = copies.with_full_color()
    assert [c.slot for c in copied] == [v.slot for v in bench.ledger.views]
    assert [c.keyframe_uid for c in copied] == [v.keyframe_uid for v in bench.ledger.views]
    assert all((c.view.image_bgr == VIEW.image_bgr).all() for c in copied)
    assert not list(bench.ledger.take_changes())

    successor = SceneLedger((), CONFIG)
    successor.correct(keyframes(0, 3))
    for view in copied:
        successor.restore(view)
    assert not list(successor.take_changes())  # the copies have them already
    add(successor, keyframes(0, 3))
    (new,) = successor.take_changes()
    assert new.slot not in {c.slot for c in copied}
    successor.clear()
    for change in successor.take_changes():
        copies.apply(change)
    assert copies.with_half_color() == []
