"""Triangulation recovers known depths and rejects points that do not fit."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.config.slam_config import CameraConfig, SlamConfig, TriangulationConfig
from rgbd_slam.local_mapping.triangulation import (
    TwoViews,
    depth_from_parallax,
    epipolar_segments,
    fits_both,
    triangulate_with_neighbors,
)
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World, position_errors_m, sway

CAMERA = StereoCamera.from_model(CameraModel(640, 480, 520.0, 515.0, 318.0, 250.0), CameraConfig())
SCALE = 1.2 ** np.arange(8.0)
T_SECOND_FIRST = se3.exp(np.array([0.02, -0.05, 0.03, -0.25, 0.05, 0.1]))


def frame_of(points_m: FloatArray, *, with_depth: bool = False, seed: int = 0) -> Frame:
    n = len(points_m)
    pixel = CAMERA.project(points_m)
    depth = points_m[:, 2] if with_depth else np.zeros(n)
    pixel[~(depth > 0), 2] = np.nan
    rng = np.random.default_rng(seed)
    return Frame(
        seed,
        pixel.astype(np.float32),
        depth.astype(np.float32),
        np.full(n, 2, np.uint8),
        np.zeros(n, np.float32),
        np.random.default_rng(9).integers(0, 256, (n, 32), dtype=np.uint8),
        rng.random(n) < 2,
    )


@pytest.fixture
def points_m() -> FloatArray:
    return np.random.default_rng(3).uniform([-1.5, -1, 2], [1.5, 1, 7], (60, 3))


def views(points_m: FloatArray, *, with_depth: bool = False) -> TwoViews:
    in_second = se3.transform(T_SECOND_FIRST, points_m)
    first, second = (frame_of(x, with_depth=with_depth) for x in (points_m, in_second))
    return TwoViews(first, second, T_SECOND_FIRST)


def test_known_depths_come_back(points_m: FloatArray) -> None:
    k = np.arange(len(points_m))
    depth = depth_from_parallax(views(points_m), k, k, CAMERA, 1e-3)
    np.testing.assert_allclose(depth, points_m[:, 2], rtol=2e-4)


def test_without_parallax_depth_is_what_was_read(points_m: FloatArray) -> None:
    k = np.arange(len(points_m))
    blind = depth_from_parallax(views(points_m), k, k, CAMERA, 0.5)
    assert not blind.any()
    read = depth_from_parallax(views(points_m, with_depth=True), k, k, CAMERA, 0.5)
    np.testing.assert_allclose(read, points_m[:, 2], rtol=1e-6)


def test_segments_go_through_what_is_seen(points_m: FloatArray) -> None:
    pair = views(points_m)
    k = np.arange(len(points_m))
    segments = epipolar_segments(pair, k, CAMERA, 0.4)
    near, far = segments[:, :2], segments[:, 2:]
    along = far - near
    seen = pair.second.measurement_px[:, :2] - near
    across = (along[:, 0] * seen[:, 1] - along[:, 1] * seen[:, 0]) / np.hypot(*along.T)
    np.testing.assert_allclose(across, 0, atol=0.01)
    share = (along * seen).sum(1) / (along**2).sum(1)
    assert ((share > 0) & (share < 1)).all()
    with_depth = views(points_m, with_depth=True)
    bounded = epipolar_segments(with_depth, k, CAMERA, 0.4)
    length = [np.hypot(*(s[:, 2:] - s[:, :2]).T) for s in (bounded, segments)]
    assert (length[0] < 0.5 * length[1]).all()


def test_what_is_behind_the_second_camera_has_no_segment(points_m: FloatArray) -> None:
    turned = views(points_m)._replace(T_second_first=se3.exp(np.array([0, np.pi, 0, 0, 0, 0.0])))
    assert np.isnan(epipolar_segments(turned, np.arange(60), CAMERA, 0.4)).all()


def test_points_must_be_where_both_views_show_them(points_m: FloatArray) -> None:
    pair = views(points_m)
    k = np.arange(len(points_m))
    assert fits_both(pair, k, k, points_m, CAMERA, SCALE).all()
    assert not fits_both(pair, k, k, 3 * points_m, CAMERA, SCALE).any()
    assert not fits_both(pair, k, k, -points_m, CAMERA, SCALE).any()
    aside = pair.second.measurement_px.copy()
    aside[:, 1] += 2.0 * np.sqrt(5.991) * SCALE[2]
    second = Frame(0, aside, *list(vars(pair.second).values())[2:7])
    assert not fits_both(pair._replace(second=second), k, k, points_m, CAMERA, SCALE).any()
    pair.second.octave[:] = 6  # two octaves coarser at the same distance
    pair.first.octave[:] = 0
    assert not fits_both(pair, k, k, points_m, CAMERA, SCALE).any()


def test_two_keyframes_make_points_where_they_are(points_m: FloatArray) -> None:
    atlas = Atlas(1.2, 8)
    known = np.arange(10)  # seen by both: they make the two neighbors
    pair = views(points_m)
    first = atlas.add_keyframe(pair.first, np.eye(4), 0)
    second = atlas.add_keyframe(pair.second, se3.inverse(T_SECOND_FIRST), 0, first)
    j = atlas.add_points(first, known, points_m[known])
    atlas.observe(second, known, j)
    atlas.update_connections(second)
    pair.second.may_seed[50:] = False
    atlas.keyframes.may_seed[second, 50:60] = False
    count = triangulate_with_neighbors(atlas, CAMERA, second, TriangulationConfig())
    seen = atlas.keyframes.point_of_feature
    assert count == 40
    assert (seen[first, :50] == seen[second, :50]).all()
    assert (seen[first, 50:] == NO_POINT).all()
    made = atlas.points.position_m[seen[first, :50]]
    np.testing.assert_allclose(made, points_m[:50], rtol=2e-3, atol=2e-3)
    assert (atlas.points.num_observations[seen[first, :50]] == 2).all()
    none = TriangulationConfig(neighbors=0)
    assert triangulate_with_neighbors(atlas, CAMERA, first, none) == 0


def test_a_camera_that_reads_depth_in_part_of_its_view_is_tracked() -> None:
    """With points from depth readings alone, the error is four times as large."""
    poses, world = sway(60), World()
    slam = RgbdSlam(MODEL, SlamConfig())
    for n, pose in enumerate(poses):
        features = world.features(n * PERIOD_NS, pose)
        features.depth_m[features.uv_px[:, 0] > 160] = 0
        assert slam.process(features).state is SlamState.TRACKING
    points = slam.map.atlas.points
    alive = points.indices()
    assert np.count_nonzero(points.num_stereo[alive] == 0) > 200
    errors = position_errors_m(slam.trajectory.final(), poses)
    assert np.sqrt((errors**2).mean()) < 0.02
