"""Depth segments, reprojection and pose scores, against references in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_native import (
    Pinhole,
    StereoParams,
    align_triples,
    depth_segments,
    occlusion_log_odds,
    propagate_log_odds,
    score_poses,
)

CAMERA = Pinhole(50.0, 50.0, 31.5, 23.5)
SHAPE = (48, 64)
MARGIN = (0.05, 0.0, 0.0)
REST = np.eye(4)


def plane(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def both(depth_m: np.ndarray) -> np.ndarray:
    """Return an image as minimum and maximum depth, (H, W, 2)."""
    return np.stack([depth_m, depth_m], axis=-1)


def with_square(depth_m: float) -> np.ndarray:
    picture = plane(3.0)
    picture[10:30, 20:40] = depth_m
    return picture


def test_segments_end_at_jumps_and_at_cells() -> None:
    found = depth_segments(with_square(1.0), 20)
    square, wall = found.label[15:18, 25:35], found.label[2:6, 2:6]
    assert found.label[9:11, 25].tolist() == [-1, -1]  # on the jump
    assert set(np.unique(square)).isdisjoint(np.unique(wall))
    assert found.label[15, 25] != found.label[22, 25]  # another cell ...
    assert found.region[found.label[15, 25]] == found.region[found.label[22, 25]]  # ... one region
    assert found.label.max() + 1 == len(found.region)
    assert found.area_px.tolist() == np.bincount(found.label.ravel() + 1)[1:].tolist()


def test_pixels_without_a_reading_have_no_segment() -> None:
    found = depth_segments(np.zeros(SHAPE, np.float32), 20)
    assert (found.label == -1).all()
    assert len(found.region) == 0
    with pytest.raises(ValueError, match='cell_px'):
        depth_segments(plane(1.0), 0)


def evidence(
    depth_m: np.ndarray, label: np.ndarray, *earlier: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the log-odds of segments from earlier views, given as (T_earlier_now, depth).

    A segment that occludes has 2, one that agrees -0.5.
    """
    views = [(T, both(earlier_m), 0.5) for T, earlier_m in earlier]
    num = int(label.max()) + 1
    return occlusion_log_odds(CAMERA, depth_m, label, num, views, MARGIN, (2.0, 0.1, 0.25))


def test_only_an_object_that_came_in_front_of_the_wall_moves() -> None:
    now, earlier = with_square(1.0), plane(3.0)
    label = depth_segments(now, 64).label
    square, wall = label[20, 30], label[2, 2]
    found = evidence(now, label, (REST, earlier))
    assert (found[square], found[wall]) == (2.0, -0.5)
    twice = evidence(now, label, (REST, earlier), (REST, earlier))
    assert twice.tolist() == (2 * found).tolist()
    assert not evidence(now, label).any()  # nothing was seen earlier
    whole = np.zeros(SHAPE, np.int32)
    # The wall was hidden behind the square.
    hidden = evidence(earlier, whole, (REST, now))
    assert hidden == -0.5 * (now == 3.0)[::2].mean()
    assert not evidence(now, label, (REST, 0 * earlier)).any()
    with pytest.raises(ValueError, match='range_m'):
        evidence(now, label, (REST, earlier[:-1]))


def test_few_occluding_pixels_are_no_evidence_and_many_outweigh_agreement() -> None:
    whole, wall = np.zeros(SHAPE, np.int32), plane(3.0)
    for rows, log_odds in (
        (4, -0.5 * 44 / 48),
        (8, 2 * 8 / 48 - 0.5 * 40 / 48),
        (16, 2 * 16 / 48),
    ):
        now = plane(3.0)
        now[:rows] = 1.0
        assert evidence(now, whole, (REST, wall))[0] == pytest.approx(log_odds)


def test_the_motion_of_the_camera_is_compensated() -> None:
    T_earlier_now = np.eye(4)
    T_earlier_now[2, 3] = 0.5  # half a meter nearer to the wall now
    label = np.zeros(SHAPE, np.int32)
    assert evidence(plane(2.5), label, (T_earlier_now, plane(3.0))) == -0.5
    assert evidence(plane(2.5), label, (REST, plane(3.0))) == 2.0


def propagated(
    T_previous_now: np.ndarray, depth_m: np.ndarray, previous_m: np.ndarray, log_odds: np.ndarray
) -> np.ndarray:
    """Return the propagated log-odds, without decay and without new evidence."""
    label, none = np.full(SHAPE, -1, np.int32), np.empty(0, np.float32)
    return propagate_log_odds(
        CAMERA, T_previous_now, depth_m, previous_m, log_odds, MARGIN, 1.0, label, none, 1e9
    )


def test_log_odds_move_with_the_pixels_where_depth_agrees() -> None:
    odds = np.arange(48 * 64, dtype=np.float32).reshape(SHAPE)
    T_previous_now = np.eye(4)
    T_previous_now[0, 3] = 0.12  # 2 px at 3 m
    moved = propagated(T_previous_now, plane(3.0), plane(3.0), odds)
    np.testing.assert_array_equal(moved[:, :-2], odds[:, 2:])
    assert (moved[:, -2:] == 0).all()
    assert not propagated(REST, plane(3.0), plane(2.0), odds).any()
    assert not propagated(REST, plane(0.0), plane(3.0), odds).any()
    with pytest.raises(ValueError, match='previous_m'):
        propagated(REST, plane(3.0), plane(3.0)[:-1], odds)


def test_log_odds_decay_and_grow_with_evidence_up_to_a_limit() -> None:
    rng = np.random.default_rng(1)
    odds = rng.uniform(-3, 3, SHAPE).astype(np.float32)
    depth_m = plane(2.0)
    depth_m[5] = 0.0
    label = rng.integers(-1, 3, SHAPE).astype(np.int32)
    evidence = np.array([-2.0, 0.5, 2.0], np.float32)
    decay, limit = np.float32(0.7), 3.0
    found = propagate_log_odds(
        CAMERA, REST, depth_m, plane(2.0), odds, MARGIN, float(decay), label, evidence, limit
    )
    added = np.where(label >= 0, evidence[label], np.float32(0))
    expected = np.where(depth_m > 0, np.clip(odds * decay + added, -limit, limit), 0)
    np.testing.assert_array_equal(found, expected)
    for wrong in (np.int32(1), np.int32(-1)):
        with pytest.raises(ValueError, match='label'):
            propagate_log_odds(
                CAMERA, REST, depth_m, depth_m, odds, MARGIN, 1.0, label + wrong, evidence, limit
            )


def test_scores_sum_the_weights_of_points_that_fit() -> None:
    camera = StereoParams(50.0, 50.0, 31.5, 23.5, 5.0, 1.0, 0.0)
    points = np.array([[0.0, 0.0, 2.0], [0.5, 0.2, 2.0], [0.1, 0.1, -1.0]])
    measured = np.array([[31.5, 23.5, 29.0], [44.0 + 1.0, 28.5, np.nan], [31.5, 23.5, np.nan]])
    weights = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    away = np.eye(4)
    away[0, 3] = 1.0
    scores = score_poses(camera, 1.0, 2.0, np.array([REST, away]), points, measured, weights)
    np.testing.assert_allclose(scores, np.array([[2.5, 25.0], [0.0, 0.0]]))
    with pytest.raises(ValueError, match='weights'):
        score_poses(camera, 1.0, 2.0, REST[None], points, measured, weights[:2])


def umeyama(from_m: np.ndarray, to_m: np.ndarray) -> np.ndarray:
    middle_from, middle_to = from_m.mean(0), to_m.mean(0)
    u, _, vt = np.linalg.svd((to_m - middle_to).T @ (from_m - middle_from))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, middle_to - R @ middle_from
    return T


def test_three_points_are_aligned_by_least_squares() -> None:
    rng = np.random.default_rng(5)
    from_m = rng.uniform(-1, 1, (60, 3))
    to_m = from_m[:, [1, 2, 0]] + [0.1, -0.2, 0.3] + rng.normal(0, 0.05, from_m.shape)
    triples = np.arange(60).reshape(20, 3)
    aligned = align_triples(from_m, to_m, triples)
    expected = [umeyama(from_m[triple], to_m[triple]) for triple in triples]
    np.testing.assert_allclose(aligned, expected, atol=1e-9)
    on_a_line = align_triples(from_m, to_m, np.array([[4, 4, 7]]))
    np.testing.assert_array_equal(on_a_line[0], REST)
    with pytest.raises(ValueError, match='triples'):
        align_triples(from_m, to_m, np.array([[0, 1, 60]]))
