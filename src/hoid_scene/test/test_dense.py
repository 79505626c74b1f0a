"""The voxels of the dense map, compared with known surfaces."""

from pathlib import Path

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_common.values import CameraModel, Float32Array
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.dense_map import DenseMap
from hoid_scene.dense.depth_view import DepthCamera, DepthView, in_boxes
from hoid_scene.dense.fusion import PosedView
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.export import write_ply
from hoid_scene.place import Anchor

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
CONFIG = DenseConfig(pixel_stride=1)
BGR = np.full((120, 160, 3), (10, 20, 30), np.uint8)
NO_PIXELS = np.zeros((120, 160), bool)


def wall(depth_m: float) -> Float32Array:
    return np.full((120, 160), depth_m, np.float32)


def posed(view: DepthView, x_m: float = 0.0) -> PosedView:
    T_map_camera = np.eye(4)
    T_map_camera[0, 3] = x_m
    return PosedView(view, 0, Anchor(0, 0, np.eye(4), T_map_camera))


def fuse(voxels: DenseMap, depth_m: Float32Array, times: int) -> None:
    for _ in range(times):
        voxels.integrate(posed(voxels.camera.view_of(depth_m, NO_PIXELS, BGR)))


def test_a_wall_is_mapped_where_it_stands_with_its_color() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    fuse(voxels, wall(2.0), 3)
    cloud = voxels.cloud()
    assert len(cloud.points_m) > 1000
    np.testing.assert_allclose(cloud.points_m[:, 2], 2.0, atol=1e-3)
    assert (cloud.colors_bgr == (10, 20, 30)).all()
    assert abs(cloud.points_m[:, 0]).max() == pytest.approx(79.5 / 130 * 2, abs=0.02)


def test_a_surface_that_too_few_images_measured_is_not_in_the_cloud() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    fuse(voxels, wall(2.0), CONFIG.min_views - 1)
    assert len(voxels.cloud().points_m) == 0


def test_a_person_who_stood_still_and_left_leaves_no_points() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    occupied = wall(3.0)
    occupied[30:100, 60:100] = 1.5
    fuse(voxels, occupied, 9)  # 3 s at 3 Hz
    assert (voxels.cloud().points_m[:, 2] < 2).any()
    fuse(voxels, wall(3.0), 6)  # 2 s later
    assert not (voxels.cloud().points_m[:, 2] < 2).any()


def test_readings_beyond_the_range_of_the_map_carve() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    occupied = wall(9.0)
    occupied[30:100, 60:100] = 1.5
    fuse(voxels, occupied, 9)
    assert len(voxels.cloud().points_m) > 0
    fuse(voxels, wall(9.0), 6)
    assert len(voxels.cloud().points_m) == 0
    assert len(voxels) == 0


def test_nothing_behind_a_surface_is_carved() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    fuse(voxels, wall(3.0), 4)
    before = len(voxels.cloud().points_m)
    fuse(voxels, wall(1.0), 10)
    assert (voxels.cloud().points_m[:, 2] > 2.9).sum() == before


def test_depth_edges_and_holes_are_left_out() -> None:
    depth = wall(1.0)
    depth[:, 80:] = 2.0
    depth[100:] = 0
    view = DepthCamera(CAMERA, CONFIG).view_of(depth, NO_PIXELS, BGR)
    assert (view.flagged_mm[:, 79:81] == 0).all()
    assert (view.flagged_mm[100:] == 0).all()
    assert (view.flagged_mm[30:90, :70] == 1000).all()


def test_far_voxels_are_kept_in_a_file_and_come_back() -> None:
    voxels, whole = (
        DenseMap(CAMERA, DenseConfig(pixel_stride=1, max_voxels=n)) for n in (12_000, 10**6)
    )
    view = voxels.camera.view_of(wall(2.0), NO_PIXELS, BGR)
    for x_m in (0.0, 4.0, 8.0, 12.0, 0.0):
        for _ in range(3):
            for each in (voxels, whole):
                each.integrate(posed(view, x_m))
                each._limit_memory(posed(view, x_m).anchor.T_map_camera[:3, 3])
        assert voxels.num_in_memory <= 12_000
    assert whole.num_in_memory == len(whole) == len(voxels) > 24_000
    np.testing.assert_array_equal(voxels.cloud().points_m, whole.cloud().points_m)


def test_lens_distortion_is_removed() -> None:
    camera = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5, (0.2, -0.3, 0.001, -0.002, 0.1))
    voxels = DenseMap(camera, CONFIG)
    fuse(voxels, wall(2.0), 1)
    assert voxels.camera.view_of(wall(2.0), NO_PIXELS, BGR).flagged_mm.shape == (120, 160)
    fuse(voxels, wall(2.0), 5)
    cloud = voxels.cloud()
    uv = camera.project_px(cloud.points_m.astype(float))
    assert (uv > -2).all()
    assert (uv < (162, 122)).all()


def test_boxes_are_enlarged_by_the_margin() -> None:
    inside = in_boxes((120, 160), np.array([[50.2, 40.0, 60.7, 130.0]], np.float32), 5)
    assert inside[35:, 45:66].all()
    assert not inside[[34, 60, 60], [50, 44, 66]].any()


def test_dynamic_pixels_add_no_surface_but_carve_in_front_of_them() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    fuse(voxels, wall(1.0), 3)
    before = len(voxels.cloud().points_m)
    is_dynamic = ~NO_PIXELS
    voxels.integrate(posed(voxels.camera.view_of(wall(1.0), is_dynamic, BGR)))
    assert len(voxels.cloud().points_m) == before  # neither confirmed nor carved
    view = voxels.camera.view_of(wall(2.0), is_dynamic, BGR)
    for _ in range(3):
        voxels.integrate(posed(view))
    assert len(voxels.cloud().points_m) == 0
    assert len(voxels) == 0


def test_a_surface_on_the_border_of_two_voxels_is_confirmed() -> None:
    voxels = DenseMap(CAMERA, CONFIG)
    for depth_m in (1.996, 2.004) * 3:  # 2.0 m is a multiple of the voxel's side
        fuse(voxels, wall(depth_m), 1)
    assert len(voxels.cloud().points_m) > 0.95 * len(voxels)


def test_a_ply_file_holds_the_points(tmp_path: Path) -> None:
    cloud = ColoredCloud(
        np.array([[1, 2, 3], [4, 5, 6]], np.float32), np.array([[1, 2, 3], [255, 0, 7]], np.uint8)
    )
    write_ply(tmp_path / 'a.ply', *cloud)
    body = (tmp_path / 'a.ply').read_bytes().split(b'end_header\n')[1]
    assert len(body) == 2 * 15
    assert body[12:15] == bytes([3, 2, 1])


def test_a_range_beyond_the_readings_that_are_used_is_refused() -> None:
    with pytest.raises(ConfigError, match=r'max_depth_m.* 12'):
        DenseConfig(max_depth_m=12.5)
