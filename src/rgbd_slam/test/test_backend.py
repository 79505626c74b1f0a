from itertools import pairwise

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import BoolArray, CameraModel, FloatArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.bundle_adjustment import BundleProblem, adjust
from rgbd_slam.optimize.gtsam_pose_graph import PoseGraph

CAMERA = StereoCamera.from_model(CameraModel(640, 480, 520.0, 515.0, 318.0, 250.0), CameraConfig())


def _ring(count: int = 12, radius_m: float = 2.0) -> FloatArray:
    """Return (count, 4, 4) poses along a circle, with the same side towards its center."""
    angle = 2 * np.pi * np.arange(count) / count
    T = se3.exp(np.stack([0 * angle, angle, 0 * angle, 0 * angle, 0 * angle, 0 * angle], 1))
    T[:, 0, 3], T[:, 2, 3] = radius_m * np.sin(angle), radius_m * np.cos(angle)
    return T


def _drifted(truth: FloatArray, drift: FloatArray) -> FloatArray:
    """Return the poses of odometry that adds the same error to each true motion."""
    out = [truth[0]]
    for a, b in pairwise(truth):
        out.append(out[-1] @ se3.inverse(a) @ b @ se3.exp(drift))
    return np.array(out)


def test_a_consistent_pose_graph_does_not_change() -> None:
    poses = _ring()
    graph = PoseGraph()
    for uid, T in enumerate(poses):
        graph.add_keyframe(uid, T, fixed=uid == 0)
    for a in range(len(poses)):
        b = (a + 1) % len(poses)
        graph.add_constraint(a, b, se3.inverse(poses[a]) @ poses[b], 0.01, 0.01)
    np.testing.assert_allclose(graph.optimize(), poses, atol=1e-9)


def test_a_loop_edge_removes_the_drift_of_a_ring() -> None:
    truth = _ring(24)
    poses = _drifted(truth, np.array([0.0, 0.006, 0.0, 0.004, 0.0, 0.006]))
    graph = PoseGraph()
    for uid, T in enumerate(poses):
        graph.add_keyframe(100 + uid, T, fixed=uid == 0)
    for a in range(len(poses) - 1):
        graph.add_constraint(100 + a, 101 + a, se3.inverse(poses[a]) @ poses[a + 1], 0.01, 0.01)
    loop = se3.inverse(truth[-1]) @ truth[0]
    graph.add_constraint(123, 100, loop, 0.001, 0.001)
    optimized = graph.optimize()
    before = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    after = np.linalg.norm(optimized[:, :3, 3] - truth[:, :3, 3], axis=1)
    assert after.max() < 0.2 * before.max()
    closing = se3.inverse(optimized[-1]) @ optimized[0]
    assert np.linalg.norm(se3.log(se3.inverse(loop) @ closing)) < 0.01


def test_two_contradicting_edges_are_averaged_by_their_sigmas() -> None:
    graph = PoseGraph()
    here, there = np.eye(4), se3.exp(np.array([0, 0, 0, 1.0, 0, 0]))
    further = se3.exp(np.array([0, 0, 0, 2.0, 0, 0]))
    graph.add_keyframe(0, here, fixed=True)
    graph.add_keyframe(1, there)
    graph.add_constraint(0, 1, there, 0.01, 0.1)
    graph.add_constraint(0, 1, further, 0.01, 0.2)
    x = graph.optimize()[1, 0, 3]
    # Weights 100 and 25: (100 * 1 + 25 * 2) / 125.
    assert x == pytest.approx(1.2, abs=1e-6)


def _bundle(
    seed: int = 0, wrong: float = 0.0
) -> tuple[FloatArray, FloatArray, BundleProblem, BoolArray]:
    """Return true poses and points, and a problem whose initial values are near these."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -1.5, 2], [2, 1.5, 4], (150, 3))
    twists = rng.normal(0, 0.08, (6, 6))
    twists[5] = 0.0
    T_camera_map = se3.exp(twists)
    pixel = np.stack([CAMERA.project(se3.transform(T, points)) for T in T_camera_map])
    seen = (pixel[..., :2] > 0).all(2) & (pixel[..., 0] < 640) & (pixel[..., 1] < 480)
    camera, point = np.nonzero(seen)
    measured = pixel[seen]
    often = np.bincount(point)[point] > 3
    camera, point, measured = camera[often], point[often], measured[often]
    counted = np.unique(point)
    point = np.searchsorted(counted, point)
    points = points[counted]
    measured[rng.random(len(measured)) < 0.3, 2] = np.nan
    false = rng.random(len(measured)) < wrong
    measured[false] += rng.choice([-40.0, 40.0], (false.sum(), 3))
    start = se3.exp(rng.normal(0, 0.01, (6, 6))) @ T_camera_map
    start[5] = T_camera_map[5]
    problem = BundleProblem(
        start, 5, (points + rng.normal(0, 0.02, points.shape)).T, camera, point, measured.T,
        1.44 ** -rng.integers(0, 8, len(camera)).astype(float),
    )  # fmt: skip
    return T_camera_map, points, problem, false


def test_bundle_adjustment_recovers_known_poses_and_points() -> None:
    T_camera_map, points, problem, _ = _bundle()
    solution = adjust(CAMERA, problem, 20)
    np.testing.assert_allclose(solution.T_camera_map, T_camera_map, atol=1e-5)
    np.testing.assert_allclose(solution.points_m.T, points, atol=1e-3)
    assert not solution.outliers.any()


def test_bundle_adjustment_identifies_false_observations() -> None:
    T_camera_map, _, problem, false = _bundle(wrong=0.03)
    solution = adjust(CAMERA, problem, 30)
    assert solution.outliers[false].mean() > 0.98
    assert solution.outliers[~false].mean() < 0.05
    np.testing.assert_allclose(
        solution.T_camera_map[:5, :3, 3], T_camera_map[:5, :3, 3], atol=0.01
    )
