"""A whole map is adjusted, and what was added meanwhile comes along."""

from __future__ import annotations

import time

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.loops.global_adjustment import GlobalAdjuster, global_problem, lay_over, solve
from rgbd_slam.model.atlas import SlamMap
from rgbd_slam.optimize.gtsam_bundle import adjust_sparse

from .ring_world import CAMERA, RingWorld, mapped, ring_poses

TRUTH = ring_poses(10, 0.3)


def _shaken() -> tuple[SlamMap, RingWorld, IntArray]:
    """Return a map whose poses, but for the first, and points are off by centimetres."""
    slam_map, world = SlamMap(1.2, 8), RingWorld()
    rows = mapped(slam_map, world, TRUTH, TRUTH)
    rng = np.random.default_rng(0)
    noise = np.r_[np.zeros((1, 6)), rng.normal(0, [0.002] * 3 + [0.01] * 3, (len(rows) - 1, 6))]
    slam_map.set_poses(rows, TRUTH @ se3.exp(noise))
    j = slam_map.points.indices()
    position = slam_map.points.position_m[j]
    slam_map.set_positions(j, position + rng.normal(0, 0.01, position.shape))
    return slam_map, world, rows


def _worst_m(slam_map: SlamMap, rows: IntArray, truth: FloatArray) -> float:
    gap = slam_map.keyframes.T_map_camera[rows, :3, 3] - truth[:, :3, 3]
    return float(np.linalg.norm(gap, axis=1).max())


def test_a_shaken_map_settles() -> None:
    slam_map, _, rows = _shaken()
    before = _worst_m(slam_map, rows, TRUTH)
    GlobalAdjuster(slam_map, CAMERA, 20, background=False).start(0)
    assert _worst_m(slam_map, rows, TRUTH) < 0.05 * before


def test_both_solvers_agree_on_a_map() -> None:
    slam_map, _, _ = _shaken()
    bundle = global_problem(slam_map, 0).bundle
    dense, sparse = solve(CAMERA, bundle, 30), adjust_sparse(CAMERA, bundle, 30)
    np.testing.assert_allclose(dense.T_camera_map, sparse.T_camera_map, atol=1e-3)


def test_keyframes_and_points_made_meanwhile_come_along() -> None:
    slam_map, _, rows = _shaken()
    keyframes = slam_map.keyframes
    problem = global_problem(slam_map, 0)
    parent = int(rows[-1])
    T_parent_new = se3.exp(np.array([0.1, 0.0, 0.0, 0.2, 0.0, 0.0]))
    frame = keyframes.frame(parent)
    new = slam_map.add_keyframe(frame, keyframes.T_map_camera[parent] @ T_parent_new, 0, parent)
    seen_m = np.array([[0.1, 0.2, 2.0], [0.0, 0.0, 3.0]])
    position_m = se3.transform(keyframes.T_map_camera[new], seen_m)
    j = slam_map.add_points(new, np.array([0, 1]), position_m)
    lay_over(slam_map, problem, solve(CAMERA, problem.bundle, 20))
    assert _worst_m(slam_map, rows, TRUTH) < 2e-3
    T_new = keyframes.T_map_camera[new]
    np.testing.assert_allclose(T_new, keyframes.T_map_camera[parent] @ T_parent_new, atol=1e-9)
    kept = se3.transform(se3.inverse(T_new), slam_map.points.position_m[j])
    np.testing.assert_allclose(kept, seen_m, atol=1e-9)


def test_what_left_the_map_meanwhile_stays_away() -> None:
    slam_map, _, rows = _shaken()
    problem = global_problem(slam_map, 0)
    slam_map.remove_keyframe(int(rows[4]))
    lay_over(slam_map, problem, solve(CAMERA, problem.bundle, 20))
    assert not slam_map.keyframes.alive[rows[4]]
    assert _worst_m(slam_map, np.delete(rows, 4), np.delete(TRUTH, 4, axis=0)) < 2e-3


def test_in_the_background_the_map_changes_only_when_asked() -> None:
    slam_map, _, rows = _shaken()
    adjuster = GlobalAdjuster(slam_map, CAMERA, 10, background=True)
    adjuster.start(0)
    before = _worst_m(slam_map, rows, TRUTH)
    assert before > 0.01
    deadline = time.monotonic() + 30
    while not adjuster.poll() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert _worst_m(slam_map, rows, TRUTH) < 0.1 * before
    assert not adjuster.poll()
    adjuster.close()
