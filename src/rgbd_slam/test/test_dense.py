"""The dense map against scenes whose surfaces are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import CameraModel, Float32Array, FloatArray
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.dense_mapper import DenseMapper
from rgbd_slam.scene.export import packed_rgb, write_pcd, write_ply
from rgbd_slam.scene.fusion_scheduler import FusionRequest
from rgbd_slam.scene.voxel_map import ColoredCloud, VoxelMap, in_boxes

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
CONFIG = DenseConfig(pixel_stride=1)
BGR = np.full((120, 160, 3), (10, 20, 30), np.uint8)
NO_BOXES = np.empty((0, 4), np.float32)
NOTHING = np.zeros((120, 160), bool)


def wall(depth_m: float) -> Float32Array:
    return np.full((120, 160), depth_m, np.float32)


def fuse(voxels: VoxelMap, depth_m: Float32Array, times: int) -> None:
    for _ in range(times):
        voxels.integrate(voxels.view_of(depth_m, NOTHING, BGR), np.eye(4))


def test_a_wall_is_mapped_where_it_stands_with_its_color() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    fuse(voxels, wall(2.0), 3)
    cloud = voxels.cloud()
    assert len(cloud.points_m) > 1000
    np.testing.assert_allclose(cloud.points_m[:, 2], 2.0, atol=1e-3)
    assert (cloud.colors_bgr == (10, 20, 30)).all()
    assert abs(cloud.points_m[:, 0]).max() == pytest.approx(79.5 / 130 * 2, abs=0.02)


def test_a_surface_seen_too_rarely_is_not_shown() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    fuse(voxels, wall(2.0), CONFIG.min_views - 1)
    assert len(voxels.cloud().points_m) == 0


def test_somebody_who_stood_still_and_left_leaves_no_ghost() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    occupied = wall(3.0)
    occupied[30:100, 60:100] = 1.5
    fuse(voxels, occupied, 9)  # 3 s at 3 Hz
    assert (voxels.cloud().points_m[:, 2] < 2).any()
    fuse(voxels, wall(3.0), 6)  # 2 s later
    assert not (voxels.cloud().points_m[:, 2] < 2).any()


def test_what_is_too_far_to_map_still_carves() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    occupied = wall(9.0)
    occupied[30:100, 60:100] = 1.5
    fuse(voxels, occupied, 9)
    assert len(voxels.cloud().points_m) > 0
    fuse(voxels, wall(9.0), 6)
    assert len(voxels.cloud().points_m) == 0
    assert len(voxels) == 0


def test_space_is_clear_before_a_surface_only() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    points = np.array([[0, 0, 1.0], [0, 0, 1.9], [0, 0, 1.99], [0, 0, 2.5], [5, 0, 1.0]])
    clear = voxels.looks_through(points, voxels.view_of(wall(2.0), NOTHING, BGR), np.eye(4))
    assert clear.tolist() == [True, True, False, False, False]


def test_nothing_behind_a_surface_is_carved() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    fuse(voxels, wall(3.0), 4)
    before = len(voxels.cloud().points_m)
    fuse(voxels, wall(1.0), 10)
    assert (voxels.cloud().points_m[:, 2] > 2.9).sum() == before


def test_depth_edges_and_holes_are_left_out() -> None:
    depth = wall(1.0)
    depth[:, 80:] = 2.0
    depth[100:] = 0
    view = VoxelMap(CAMERA, CONFIG).view_of(depth, NOTHING, BGR)
    assert (view.flagged_mm[:, 79:81] == 0).all()
    assert (view.flagged_mm[100:] == 0).all()
    assert (view.flagged_mm[30:90, :70] == 1000).all()


def test_the_memory_bound_keeps_the_best_seen() -> None:
    voxels = VoxelMap(CAMERA, DenseConfig(pixel_stride=1, max_voxels=1000))
    fuse(voxels, wall(2.0), 3)
    assert len(voxels) == 1000


def test_distortion_of_the_camera_is_undone() -> None:
    camera = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5, (0.2, -0.3, 0.001, -0.002, 0.1))
    voxels = VoxelMap(camera, CONFIG)
    fuse(voxels, wall(2.0), 1)
    assert voxels.view_of(wall(2.0), NOTHING, BGR).flagged_mm.shape == (120, 160)
    fuse(voxels, wall(2.0), 5)
    cloud = voxels.cloud()
    uv = camera.project_px(cloud.points_m.astype(float))
    assert (uv > -2).all()
    assert (uv < (162, 122)).all()


def keyframes(
    *uids: int, T: FloatArray | None = None, map_id: int = 0, version: int = 1
) -> KeyframePoses:
    poses = np.array([np.eye(4) if T is None else T] * len(uids))
    return KeyframePoses(version, np.array(uids, np.int64), np.full(len(uids), map_id), 0, poses)


def add(mapper: DenseMapper, known: KeyframePoses) -> None:
    pose = FusionRequest(0, np.eye(4), int(known.uids[-1]), known)
    mapper.add(pose, wall(2.0), BGR, NO_BOXES)


def test_a_corrected_keyframe_moves_what_it_saw() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    for i in range(3):
        add(mapper, keyframes(*range(i + 1)))
    T = se3.exp(np.array([0, 0, 0, 0.3, 0, 0.5]))
    assert not mapper.correct(keyframes(0, 1, 2))
    assert mapper.correct(keyframes(0, 1, 2, T=T))
    np.testing.assert_allclose(mapper.cloud().points_m[:, 2], 2.5, atol=1e-3)


def test_small_corrections_wait_and_settling_takes_them() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    for _ in range(4):
        add(mapper, keyframes(0))
    moved = keyframes(0, T=se3.exp(np.array([0, 0, 0, 0, 0, 0.02])))
    assert not mapper.correct(moved)
    assert mapper.correct(moved, settle=True)
    np.testing.assert_allclose(mapper.cloud().points_m[:, 2], 2.02, atol=1e-3)


def test_views_of_a_culled_keyframe_hang_on_one_that_stays() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    for i in range(4):
        add(mapper, keyframes(*range(i + 1)))
    mapper.correct(keyframes(0, 3))
    assert mapper.correct(keyframes(0, 3, T=se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))))
    np.testing.assert_allclose(mapper.cloud().points_m[:, 2], 3.0, atol=1e-3)
    assert len(mapper.views) == 4


def test_views_of_a_map_that_is_gone_go() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    for _ in range(4):
        add(mapper, keyframes(0))
    mapper.correct(keyframes(100), settle=True)
    assert not mapper.views
    assert len(mapper.cloud().points_m) == 0


def test_views_of_another_map_wait_until_it_is_joined() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    for _ in range(4):
        add(mapper, keyframes(0, map_id=1))
    assert len(mapper.views) == 4
    assert len(mapper.cloud().points_m) == 0
    T = se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))
    assert mapper.correct(keyframes(0, T=T))
    np.testing.assert_allclose(mapper.cloud().points_m[:, 2], 3.0, atol=1e-3)
    assert mapper.correct(keyframes(0, map_id=1))
    assert len(mapper.cloud().points_m) == 0


def test_a_view_that_comes_late_takes_its_place_in_the_map_as_it_is_now() -> None:
    mapper = DenseMapper(CAMERA, CONFIG)
    mapper.correct(keyframes(0, 1, T=se3.exp(np.array([0, 0, 0, 0, 0, 1.0])), version=2))
    for _ in range(3):
        add(mapper, keyframes(0))
    np.testing.assert_allclose(mapper.cloud().points_m[:, 2], 3.0, atol=1e-3)


def test_a_map_of_views_is_restored_by_its_keyframes() -> None:
    mapper, other = DenseMapper(CAMERA, CONFIG), DenseMapper(CAMERA, CONFIG)
    for i in range(3):
        add(mapper, keyframes(*range(i + 1)))
    other.correct(keyframes(0, 1, 2))
    for view in mapper.views:
        other.restore(view)
    np.testing.assert_array_equal(other.cloud().points_m, mapper.cloud().points_m)
    other.restore(replace(mapper.views[0], keyframe_uid=99))
    assert len(other.views) == 3


def test_the_views_kept_are_few_and_apart() -> None:
    mapper = DenseMapper(CAMERA, DenseConfig(pixel_stride=2, max_views=5))
    for i in range(20):
        T = se3.exp(np.array([0, 0, 0, 0.1 * (i // 4), 0, 0]))  # four at each of five places
        mapper.add(FusionRequest(i, T, 0, keyframes(0)), wall(2.0), BGR, NO_BOXES)
    assert len(mapper.views) == 5
    mapper.correct(keyframes(0), settle=True)
    assert np.ptp(mapper._voxels._sums[:, 0] / mapper._voxels._sums[:, 6]) > 2.7


def test_boxes_are_dynamic_with_their_margin() -> None:
    inside = in_boxes((120, 160), np.array([[50.2, 40.0, 60.7, 130.0]], np.float32), 5)
    assert inside[35:, 45:66].all()
    assert not inside[[34, 60, 60], [50, 44, 66]].any()


def test_what_is_dynamic_is_no_surface_but_free_before_it() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    fuse(voxels, wall(1.0), 3)
    before = len(voxels.cloud().points_m)
    somebody = ~NOTHING
    voxels.integrate(voxels.view_of(wall(1.0), somebody, BGR), np.eye(4))
    assert len(voxels.cloud().points_m) == before  # neither confirmed nor carved
    view = voxels.view_of(wall(2.0), somebody, BGR)
    for _ in range(3):
        voxels.integrate(view, np.eye(4))
    assert len(voxels.cloud().points_m) == 0
    assert len(voxels) == 0


def test_a_surface_on_the_border_of_two_voxels_is_not_lost() -> None:
    voxels = VoxelMap(CAMERA, CONFIG)
    for depth_m in (1.996, 2.004) * 3:  # 2.0 m is a multiple of the voxel's side
        fuse(voxels, wall(depth_m), 1)
    assert len(voxels.cloud().points_m) > 0.95 * len(voxels)


def test_ply_and_pcd_hold_the_points(tmp_path: Path) -> None:
    cloud = ColoredCloud(
        np.array([[1, 2, 3], [4, 5, 6]], np.float32), np.array([[1, 2, 3], [255, 0, 7]], np.uint8)
    )
    write_ply(tmp_path / 'a.ply', cloud)
    body = (tmp_path / 'a.ply').read_bytes().split(b'end_header\n')[1]
    assert len(body) == 2 * 15
    assert body[12:15] == bytes([3, 2, 1])
    write_pcd(tmp_path / 'a.pcd', cloud)
    body = (tmp_path / 'a.pcd').read_bytes().split(b'DATA binary\n')[1]
    assert np.frombuffer(body, '<f4').reshape(2, 4)[:, :3].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert packed_rgb(cloud).view(np.uint32).tolist() == [0x030201, 0x0700FF]
