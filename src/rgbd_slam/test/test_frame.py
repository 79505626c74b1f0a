"""Features as the tracker uses them: undistorted, with a virtual right column."""

import numpy as np
import pytest

from hoid_common.values import CameraModel, Features, FloatArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.frame import Frame, StereoCamera

FR1 = CameraModel(
    640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
)  # strong plumb-bob distortion of a real camera
CONFIG = CameraConfig()


def features_at(uv_px: FloatArray, depth_m: FloatArray) -> Features:
    n = len(uv_px)
    return Features(
        7,
        uv_px.astype(np.float32),
        depth_m.astype(np.float32),
        np.zeros(n, np.uint8),
        np.zeros(n, np.float32),
        np.ones(n, np.float32),
        np.zeros((n, 32), np.uint8),
        np.ones(n, np.bool_),
    )


def seen_points() -> FloatArray:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.2, -0.9, 1.0], [1.2, 0.9, 4.0], (200, 3))
    pixels = FR1.project_px(points)
    inside = ((pixels > 0) & (pixels < (639, 479))).all(1)
    return np.asarray(points[inside & (np.abs(points[:, 0]) < 0.5 * points[:, 2])])


def test_points_seen_through_a_distorting_lens_come_back() -> None:
    points = seen_points()
    camera = StereoCamera.from_model(FR1, CONFIG)
    uv = FR1.project_px(points)
    bent_px = np.linalg.norm(uv - camera.project(points)[:, :2], axis=1)
    assert bent_px.max() > 5  # the lens matters
    frame = Frame.from_features(features_at(uv, points[:, 2]), FR1, camera)
    np.testing.assert_allclose(frame.measurement_px, camera.project(points), atol=0.05)
    back = camera.back_project(frame.measurement_px, frame.depth_m)
    np.testing.assert_allclose(back, points, atol=4e-4)


def test_the_virtual_right_column_is_that_of_a_stereo_pair() -> None:
    """A second camera, one baseline to the right, sees the point in column u_right, same row."""
    points = seen_points()
    camera = StereoCamera.from_model(FR1, CONFIG)
    left = camera.project(points)
    right = camera.project(points - [CONFIG.baseline_m, 0, 0])
    np.testing.assert_allclose(left[:, 2], right[:, 0], atol=1e-9)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)


def test_the_right_column_by_hand() -> None:
    model = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0)
    camera = StereoCamera.from_model(model, CONFIG)
    uv = np.array([[400.0, 100.0]] * 4)
    depth = np.array([2.0, 0.0, np.nan, -1.0])
    frame = Frame.from_features(features_at(uv, depth), model, camera)
    # disparity = 500 px * 0.075 m / 2 m
    assert frame.measurement_px[0].tolist() == [400.0, 100.0, 400.0 - 18.75]
    assert np.isnan(frame.measurement_px[1:, 2]).all()
    assert frame.has_depth.tolist() == [True, False, False, False]
    assert frame.depth_m.tolist() == [2.0, 0.0, 0.0, 0.0]


def test_rows_and_columns_project_alike() -> None:
    camera = StereoCamera.from_model(CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0), CONFIG)
    points = np.array([[0.4, -0.2, 2.0], [0.0, 0.0, 5.0]])
    expected_px = [[420.0, 190.0, 401.25], [320.0, 240.0, 312.5]]  # 18.75 and 7.5 px apart
    np.testing.assert_allclose(camera.project(points), expected_px, atol=1e-12)
    np.testing.assert_array_equal(camera.project_rows(points.T).T, camera.project(points))


def test_bounds_hold_every_undistorted_pixel() -> None:
    camera = StereoCamera.from_model(FR1, CONFIG)
    u_min, v_min, u_max, v_max = camera.bounds_px
    v, u = np.mgrid[0:480:40, 0:640:40]
    inner = FR1.undistort_px(np.stack([u, v], -1).reshape(-1, 2).astype(np.float32))
    assert (inner >= (u_min - 0.5, v_min - 0.5)).all()
    assert (inner <= (u_max + 0.5, v_max + 0.5)).all()
    assert u_max - u_min == pytest.approx(640, rel=0.2)
