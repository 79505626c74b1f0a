import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hoid_common import se3
from hoid_common.values import BoolArray, CameraModel, Float32Array, FloatArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.optimize import alignment
from rgbd_slam.optimize.alignment import Alignment, align_image, align_points

CAMERA = StereoCamera.from_model(CameraModel(640, 480, 520.0, 515.0, 318.0, 250.0), CameraConfig())
T_CAMERA_POINTS = se3.exp(np.array([0.2, -0.4, 0.1, 0.5, -0.2, 0.3]))


def _scene(
    count: int = 120, seed: int = 0, wrong: float = 0.5, depth_share: float = 1.0
) -> tuple[Float32Array, Float32Array, FloatArray, BoolArray]:
    """Return measurement, depth, points and mask of right matches of a camera at a known pose."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.8, 3.0, count)
    uv = np.stack([rng.uniform(20, 620, count), rng.uniform(20, 460, count)], 1)
    in_camera = CAMERA.back_project(uv, depth)
    points = se3.transform(se3.inverse(T_CAMERA_POINTS), in_camera)
    right = rng.random(count) >= wrong
    points[~right] = points[rng.permutation(count)[: (~right).sum()]] + 0.3
    # A Kinect's noise, 13 mm at 3 m.
    disparity = CAMERA.baseline_px_m / depth + rng.normal(0, 0.06, count)
    measurement = CAMERA.project(in_camera) + rng.normal(0, 0.3, (count, 3))
    measurement[:, 2] = measurement[:, 0] - disparity
    has_depth = rng.random(count) < depth_share
    depth = np.where(has_depth, CAMERA.baseline_px_m / (measurement[:, 0] - measurement[:, 2]), 0)
    measurement[~has_depth, 2] = np.nan
    return measurement.astype(np.float32), depth.astype(np.float32), points, right


def _aligned(
    measurement: Float32Array, depth: Float32Array, points: FloatArray, seed: int = 0
) -> Alignment | None:
    rng = np.random.default_rng(seed)
    count = len(points)
    octave, angle_deg = np.zeros(count, np.uint8), np.zeros(count, np.float32)
    descriptors, may_seed = np.zeros((count, 32), np.uint8), np.ones(count, np.bool_)
    frame = Frame(0, measurement, depth, octave, angle_deg, descriptors, may_seed)
    return align_image(frame, np.arange(count), points, np.ones(1), CAMERA, rng)


def _error(T: FloatArray) -> tuple[float, float]:
    twist = se3.log(se3.inverse(T_CAMERA_POINTS) @ T)
    return float(np.rad2deg(np.linalg.norm(twist[:3]))), float(np.linalg.norm(twist[3:]))


def test_horn_alignment_recovers_a_known_transform_exactly() -> None:
    points = np.random.default_rng(0).normal(size=(7, 3))
    T = align_points(se3.transform(T_CAMERA_POINTS, points), points)
    np.testing.assert_allclose(T, T_CAMERA_POINTS, atol=1e-12)


def test_horn_alignment_of_a_quarter_turn_by_hand() -> None:
    b = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    a = np.array([[1.0, 2, 3], [1, 3, 3], [0, 2, 3]])
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(align_points(a, b), expected, atol=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(3, 10))
def test_horn_alignment_is_a_rotation_even_of_mirrored_or_flat_points(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 4, count, 3))
    a[1] = b[1] * [1, 1, -1]
    b[2, :, 2] = 0
    R = align_points(a, b)[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)


@pytest.mark.parametrize('depth_share', [1.0, 0.5, 0.0])
def test_a_pose_is_found_among_half_wrong_matches(depth_share: float) -> None:
    measurement, depth, points, right = _scene(depth_share=depth_share)
    result = _aligned(measurement, depth, points)
    assert result is not None
    angle_deg, gap_m = _error(result.T_camera_points)
    assert angle_deg < 0.5
    assert gap_m < 0.02
    assert result.inliers[right].mean() > 0.9
    assert result.inliers[~right].mean() < 0.1


def test_eighty_percent_wrong_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alignment, '_NUM_HYPOTHESES', 600)
    measurement, depth, points, right = _scene(count=250, wrong=0.8)
    result = _aligned(measurement, depth, points)
    assert result is not None
    assert _error(result.T_camera_points)[1] < 0.02
    assert result.inliers[right].mean() > 0.9


def test_the_same_seed_gives_the_same_answer() -> None:
    measurement, depth, points, _ = _scene()
    first, second = (_aligned(measurement, depth, points, seed=3) for _ in range(2))
    assert first is not None
    assert second is not None
    assert (first.T_camera_points == second.T_camera_points).all()


def test_random_matches_give_no_pose() -> None:
    measurement, depth, points, _ = _scene(wrong=1.0)
    points = np.random.default_rng(5).permutation(points)
    assert _aligned(measurement, depth, points) is None


@pytest.mark.parametrize('seed', range(0, 240, 2))
def test_points_that_determine_no_pose_are_no_error(seed: int) -> None:
    """OpenCV's PnP asserts on the samples of some of these."""
    rng = np.random.default_rng(seed)
    line = np.outer(rng.uniform(0, 1, 20), rng.normal(size=3)) + np.array([0, 0, 2])
    few = (rng.normal(size=(20, 3)) + np.array([0, 0, 3]))[rng.integers(0, 4, 20)]
    points = line if seed % 4 else few
    uv = rng.uniform(0, 480, (20, 2))[rng.integers(0, 20, 20)]
    measurement = np.c_[uv, np.full(20, np.nan)].astype(np.float32)
    found = _aligned(measurement, np.zeros(20, np.float32), points)
    assert found is None or found.inliers.sum() >= 15


def test_too_few_matches_give_no_pose() -> None:
    measurement, depth, points, _ = _scene(count=8, wrong=0.0)
    assert _aligned(measurement, depth, points) is None


def test_points_behind_the_camera_are_no_inliers() -> None:
    measurement, depth, points, _ = _scene(wrong=0.0)
    points[:40] = se3.transform(
        se3.inverse(T_CAMERA_POINTS), -CAMERA.back_project(measurement[:40], depth[:40])
    )
    result = _aligned(measurement, depth, points)
    assert result is not None
    assert not result.inliers[:40].any()
    assert result.inliers[40:].mean() > 0.9
