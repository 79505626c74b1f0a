"""Global bundle adjustment; keyframes and points that were added meanwhile move as well."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.loops.essential_graph import move_map
from rgbd_slam.loops.global_adjustment import GlobalAdjuster, apply_solution, global_problem, solve
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.optimize.bundle_adjustment import BundleSolution

from .ring_world import CAMERA, RingWorld, mapped, ring_poses

TRUTH = ring_poses(10, 0.3)


def _shaken() -> tuple[Atlas, RingWorld, IntArray]:
    """Return a map whose points and poses, except the first pose, have errors of centimeters."""
    atlas, world = Atlas(1.2, 8), RingWorld()
    rows = mapped(atlas, world, TRUTH, TRUTH)
    rng = np.random.default_rng(0)
    noise = np.r_[np.zeros((1, 6)), rng.normal(0, [0.002] * 3 + [0.01] * 3, (len(rows) - 1, 6))]
    atlas.set_poses(rows, TRUTH @ se3.exp(noise))
    j = atlas.points.indices()
    position = atlas.points.position_m[j]
    atlas.set_positions(j, position + rng.normal(0, 0.01, position.shape))
    return atlas, world, rows


def _worst_m(atlas: Atlas, rows: IntArray, truth: FloatArray) -> float:
    gap = atlas.keyframes.T_map_camera[rows, :3, 3] - truth[:, :3, 3]
    return float(np.linalg.norm(gap, axis=1).max())


def test_a_perturbed_map_is_restored() -> None:
    atlas, _, rows = _shaken()
    before = _worst_m(atlas, rows, TRUTH)
    GlobalAdjuster(atlas, CAMERA, 20, background=False).start(rows[-1:])
    assert _worst_m(atlas, rows, TRUTH) < 0.05 * before


def test_in_a_large_map_only_the_keyframes_around_a_loop_move(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr('rgbd_slam.loops.global_adjustment._MAX_KEYFRAMES', 3)
    atlas, _, rows = _shaken()
    before = atlas.keyframes.T_map_camera[rows].copy()
    GlobalAdjuster(atlas, CAMERA, 20, background=False).start(rows[-1:])
    after = atlas.keyframes.T_map_camera[rows]
    has_moved = np.abs(after - before).max((1, 2)) > 1e-4
    assert has_moved.sum() == 3
    assert has_moved[-1]
    np.testing.assert_array_equal(after[~has_moved], before[~has_moved])


def test_a_solution_is_moved_by_a_loop_that_was_closed_meanwhile() -> None:
    atlas, _, rows = _shaken()
    problem = global_problem(atlas, rows[-1:])
    bundle = problem.bundle
    nothing = np.zeros(len(bundle.camera), np.bool_)
    as_it_was = BundleSolution(bundle.T_camera_map, bundle.points_m, nothing)
    move = move_map(atlas, rows[1:], TRUTH[1:])
    j = atlas.points.indices()
    position_m = atlas.points.position_m[j]
    apply_solution(atlas, problem, as_it_was, [move])
    np.testing.assert_allclose(atlas.keyframes.T_map_camera[rows[1:]], TRUTH[1:], atol=1e-9)
    np.testing.assert_allclose(atlas.points.position_m[j], position_m, atol=1e-9)


def test_keyframes_and_points_made_meanwhile_come_along() -> None:
    atlas, _, rows = _shaken()
    keyframes = atlas.keyframes
    problem = global_problem(atlas, rows[-1:])
    parent = int(rows[-1])
    T_parent_new = se3.exp(np.array([0.1, 0.0, 0.0, 0.2, 0.0, 0.0]))
    frame = keyframes.frame(parent)
    new = atlas.add_keyframe(frame, keyframes.T_map_camera[parent] @ T_parent_new, 0, parent)
    seen_m = np.array([[0.1, 0.2, 2.0], [0.0, 0.0, 3.0]])
    position_m = se3.transform(keyframes.T_map_camera[new], seen_m)
    j = atlas.add_points(new, np.array([0, 1]), position_m)
    apply_solution(atlas, problem, solve(CAMERA, problem.bundle, 20))
    assert _worst_m(atlas, rows, TRUTH) < 2e-3
    T_new = keyframes.T_map_camera[new]
    np.testing.assert_allclose(T_new, keyframes.T_map_camera[parent] @ T_parent_new, atol=1e-9)
    kept = se3.transform(se3.inverse(T_new), atlas.points.position_m[j])
    np.testing.assert_allclose(kept, seen_m, atol=1e-9)


def test_what_left_the_map_meanwhile_stays_away() -> None:
    atlas, _, rows = _shaken()
    problem = global_problem(atlas, rows[-1:])
    atlas.remove_keyframe(int(rows[4]))
    apply_solution(atlas, problem, solve(CAMERA, problem.bundle, 20))
    assert not atlas.keyframes.alive[rows[4]]
    assert _worst_m(atlas, np.delete(rows, 4), np.delete(TRUTH, 4, axis=0)) < 2e-3


def test_in_the_background_the_map_changes_only_when_asked() -> None:
    atlas, _, rows = _shaken()
    adjuster = GlobalAdjuster(atlas, CAMERA, 10, background=True)
    adjuster.start(rows[-1:])
    before = _worst_m(atlas, rows, TRUTH)
    assert before > 0.01
    deadline = time.monotonic() + 30
    while not adjuster.poll() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert _worst_m(atlas, rows, TRUTH) < 0.1 * before
    assert not adjuster.poll()
    adjuster.close()
