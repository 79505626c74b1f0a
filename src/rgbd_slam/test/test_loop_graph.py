"""Poses corrected by loop edges, and the points that move with them."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from rgbd_slam.loops.essential_graph import (
    closed_poses,
    move_map,
    optimized,
    path_length_m,
    region_around,
)
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import renumbered
from rgbd_slam.model.map_state import restore, snapshot

from .drifting_ring import LAPS, drifting_map, errors_m, loop_edge
from .ring_world import CAMERA


def test_the_path_between_keyframes_follows_shared_points() -> None:
    atlas, rows, truth = drifting_map()
    lap_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    lap_rad = 2 * np.pi * LAPS * (len(rows) - 1) / len(rows)
    way_m = path_length_m(atlas, int(rows[0]), int(rows[-1]))
    assert way_m == pytest.approx(lap_m + 0.3 * lap_rad, rel=0.1)


def test_points_follow_their_keyframe_through_a_correction() -> None:
    atlas, rows, truth = drifting_map()
    keyframes, points = atlas.keyframes, atlas.points
    i, k = rows[10], np.flatnonzero(keyframes.point_of_feature[rows[10]] >= 0)
    j = keyframes.point_of_feature[i, k].astype(np.int64)
    own = points.reference_keyframe_uid[j] == keyframes.uid[i]
    seen_before = se3.transform(se3.inverse(keyframes.T_map_camera[i]), points.position_m[j])
    move_map(atlas, rows, truth)
    seen_after = se3.transform(se3.inverse(truth[10]), points.position_m[j])
    assert own.sum() > 5
    np.testing.assert_allclose(seen_after[own], seen_before[own], atol=1e-9)


def test_hundreds_of_loops_leave_rotations_and_positions_finite() -> None:
    atlas, rows, _ = drifting_map()
    moved = np.empty((len(rows), 4, 4))
    rng = np.random.default_rng(0)
    for _ in range(300):
        correction = se3.exp(rng.normal(0, 1e-3, (len(rows), 6)))
        moved = correction @ atlas.keyframes.T_map_camera[rows]
        move_map(atlas, rows, moved)
    T = atlas.keyframes.T_map_camera[rows]
    R = T[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.swapaxes(1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(T, moved, atol=1e-9)
    assert np.isfinite(atlas.points.position_m).all()


def test_a_loop_edge_moves_the_end_to_where_it_was_measured() -> None:
    atlas, rows, truth = drifting_map()
    uid = atlas.keyframes.uid
    T_first_last = se3.inverse(truth[0]) @ truth[-1]
    loop = loop_edge(int(uid[rows[0]]), int(uid[rows[-1]]), T_first_last)
    region = region_around(atlas, rows[[0, -1]], len(rows))
    assert len(region.border) == 0
    T = closed_poses(atlas, region, [loop], 100)
    assert region.rows.tolist() == sorted(rows.tolist())
    last = T[region.rows.tolist().index(int(rows[-1]))]
    np.testing.assert_allclose(last[:3, 3], truth[-1, :3, 3], atol=0.01)
    np.testing.assert_allclose(T[region.rows.tolist().index(int(rows[0]))], truth[0], atol=1e-9)


def test_the_uncertainty_of_a_loop_is_that_of_its_end_and_not_of_the_head_of_a_group(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The position of the end is measured well and its rotation badly, by 0.2 rad."""
    monkeypatch.setattr('rgbd_slam.loops.keyframe_groups._MAX_NODES', 6)
    atlas, rows, truth = drifting_map()
    uid = atlas.keyframes.uid
    turned = truth[-1] @ se3.exp(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    covariance = np.diag(np.square([0.2] * 3 + [0.001] * 3))
    loop = loop_edge(
        int(uid[rows[0]]), int(uid[rows[-1]]), se3.inverse(truth[0]) @ turned, covariance
    )
    region = region_around(atlas, rows[[0, -1]], len(rows))
    T = closed_poses(atlas, region, [loop], 100)
    last = T[region.rows.tolist().index(int(rows[-1]))]
    np.testing.assert_allclose(last[:3, 3], truth[-1, :3, 3], atol=0.02)


def test_a_loop_that_contradicts_the_others_is_left_out_and_kept_with_its_evidence() -> None:
    for order in (1, -1):  # the wrong one is the newest, or the oldest
        atlas, rows, truth = drifting_map()
        uid = atlas.keyframes.uid[rows].tolist()
        true = [
            loop_edge(uid[a], uid[b], se3.inverse(truth[a]) @ truth[b])
            for a, b in ((0, -1), (1, -2))
        ]
        T_wrong = se3.inverse(truth[0]) @ truth[-1]
        T_wrong[0, 3] += 2.0
        edges = [*true, loop_edge(uid[0], uid[-1], T_wrong)][::order]
        atlas.loops = tuple(edges)
        region = region_around(atlas, rows[[0, -1]], len(rows))
        T_map_camera, loops = optimized(atlas, region, 100)
        used = [edge.is_used for edge in loops]
        assert used == [True, True, False][::order]
        assert loops[np.argmin(used)].residual_m == pytest.approx(2.0, abs=0.05)
        assert max(edge.residual_m for edge in loops if edge.is_used) < 0.02
        move_map(atlas, region.rows, T_map_camera)
        assert errors_m(atlas, rows, truth).max() < 0.1  # of 0.2 m


def test_a_loop_outlives_its_keyframes_and_is_saved() -> None:
    atlas, rows, _ = drifting_map()
    uid = atlas.keyframes.uid[rows].tolist()
    T = atlas.keyframes.T_map_camera[rows]
    atlas.loops = (loop_edge(uid[2], uid[-2], se3.inverse(T[2]) @ T[-2]),)
    for n in (2, -2):
        atlas.remove_keyframe(int(rows[n]))
    (edge,) = atlas.loops
    assert edge[:2] == (uid[1], uid[-3])
    np.testing.assert_allclose(edge.T_first_second, se3.inverse(T[1]) @ T[-3], atol=1e-9)
    loaded, state = Atlas(1.2, 8), snapshot(atlas)
    saved = renumbered(
        atlas.loops, {u: n for n, u in enumerate(sorted(set(uid) - {uid[2], uid[-2]}))}
    )
    restore(loaded, state, CAMERA, 100, keep=False, loops=saved)
    assert loaded.loops[0][:2] == (101, 100 + len(state) - 2)
    np.testing.assert_array_equal(loaded.loops[0].T_first_second, edge.T_first_second)


def test_a_loop_in_a_large_map_corrects_the_keyframes_around_it() -> None:
    atlas, rows, truth = drifting_map()
    region = region_around(atlas, rows[[0, -1]], 9)
    assert len(region.rows) == 9
    assert len(region.border) > 0
    assert not np.isin(region.border, region.rows).any()
    uid = atlas.keyframes.uid[rows]
    loop = loop_edge(int(uid[0]), int(uid[-1]), se3.inverse(truth[0]) @ truth[-1])
    T = closed_poses(atlas, region, [loop], 100)
    assert len(T) == len(region.rows)
    before = atlas.keyframes.T_map_camera[rows[-1]]
    after = T[region.rows.tolist().index(int(rows[-1]))]
    drift_m = np.linalg.norm(before[:3, 3] - truth[-1, :3, 3])
    assert np.linalg.norm(after[:3, 3] - truth[-1, :3, 3]) < 0.8 * drift_m
