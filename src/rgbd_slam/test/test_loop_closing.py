"""Loops, merged maps and relocalization on worlds with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.place_config import LoopConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.drift_limit import DriftLimit
from rgbd_slam.loops.essential_graph import closed_poses, move_map, path_length_m
from rgbd_slam.loops.loop_closer import Join, LoopCloser, LoopEvent
from rgbd_slam.loops.loop_graph import optimized
from rgbd_slam.loops.map_merging import merge_maps
from rgbd_slam.loops.region import region_around
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.loop_edge import LoopEdge, renumbered
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceVerifier
from rgbd_slam.places.place_finder import PlaceFinder

from .ring_world import CAMERA, RingWorld, drifted, mapped, ring_poses

DRIFT = np.array([0.0, 0.002, 0.0, 0.006, 0.003, 0.0])
LAPS = 1.06
_SURE = np.diag(np.square([0.001] * 3 + [0.002] * 3))  # covariance of a loop


def _errors_m(atlas: Atlas, rows: IntArray, truth: FloatArray) -> FloatArray:
    gap = atlas.keyframes.T_map_camera[rows, :3, 3] - truth[:, :3, 3]
    return np.asarray(np.linalg.norm(gap, axis=1))


@pytest.fixture(scope='module')
def drifting() -> tuple[Atlas, IntArray, FloatArray]:
    """Return a map of slightly more than one lap, whose end has drifted from its beginning."""
    truth = ring_poses(36, LAPS)
    atlas = Atlas(1.2, 8)
    rows = mapped(atlas, RingWorld(), truth, drifted(truth, DRIFT))
    return atlas, rows, truth


def _edge(
    first_uid: int, second_uid: int, T_first_second: FloatArray, covariance: FloatArray = _SURE
) -> LoopEdge:
    return LoopEdge(
        first_uid, second_uid, T_first_second, covariance, 50, 1.0, 'closed', 0.0, is_used=True
    )


def _copy(atlas: Atlas) -> Atlas:
    fresh = Atlas(1.2, 8)
    fresh.apply(atlas.changes_since(0))
    return fresh


def test_a_loop_is_closed_and_the_drift_is_gone(
    drifting: tuple[Atlas, IntArray, FloatArray], caplog: pytest.LogCaptureFixture
) -> None:
    original, rows, truth = drifting
    atlas = _copy(original)
    before = _errors_m(atlas, rows, truth)
    points_before = len(atlas.points)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    with caplog.at_level('INFO', 'rgbd_slam.loops.loop_closer'):
        assert closer.process(int(rows[-1])) is LoopEvent.CLOSED
    (join,) = (join for record in caplog.records for join in record.args or ())
    assert isinstance(join, Join)
    assert (join.event, join.stamp_ns) == (LoopEvent.CLOSED, atlas.keyframes.stamp_ns[rows[-1]])
    place = atlas.keyframes.stamp_ns[rows].tolist().index(join.place_stamp_ns)
    T_place_camera = se3.inverse(truth[place]) @ truth[-1]
    np.testing.assert_allclose(join.T_place_camera, T_place_camera, atol=0.01)
    after = _errors_m(atlas, rows, truth)
    assert before.max() > 0.1
    assert after.max() < 0.15 * before.max()
    assert len(atlas.points) < points_before - 100  # seen twice, one point now
    assert rows[0] in atlas.covisible(rows[-1], min_shared=51)


def test_a_place_that_looks_alike_in_other_surroundings_joins_no_maps() -> None:
    """Two round rooms have one half of their walls in common."""
    poses, closed = ring_poses(36), []
    for share in (1.0, 0.5):
        here, there = RingWorld(), RingWorld()
        is_other = np.arctan2(there.points_m[:, 0], there.points_m[:, 2]) < np.pi * (1 - 2 * share)
        unlike = np.random.default_rng(5).integers(0, 256, there.descriptors.shape, np.uint8)
        there.descriptors = np.where(is_other[:, None], unlike, there.descriptors)
        atlas = Atlas(1.2, 8)
        rows = [mapped(atlas, here, poses, poses, 0), mapped(atlas, there, poses, poses, 1)]
        closer = LoopCloser(atlas, CAMERA, SlamConfig())
        closed.append([closer.process(i) for i in rows[1].tolist()])
    assert LoopEvent.MERGED in closed[0]
    assert LoopEvent.MERGED not in closed[1]


def test_a_room_that_looks_alike_is_no_loop_however_long_it_is_seen() -> None:
    """Two round rooms, one above the other; the second one has other walls at its entrance."""
    room, elsewhere = ring_poses(36), ring_poses(150)
    later = np.concatenate([ring_poses(24, turns=0.5), ring_poses(180)[90:160]])
    up, away = np.eye(4), np.eye(4)
    up[1, 3], away[0, 3] = -3.2, 100.0
    events = []
    for is_alike in (True, False):
        below, above = RingWorld(), RingWorld()
        is_other = (above.points_m[:, 0] > 0) & (not is_alike)
        unlike = np.random.default_rng(5).integers(0, 256, above.descriptors.shape, np.uint8)
        above.descriptors = np.where(is_other[:, None], unlike, above.descriptors)
        atlas = Atlas(1.2, 8)
        mapped(atlas, below, room, room)
        mapped(atlas, RingWorld(300, seed=1), elsewhere, away @ elsewhere)
        rows = mapped(atlas, above, later, up @ later)
        closer = LoopCloser(atlas, CAMERA, SlamConfig())
        events.append(closer.process(int(rows[-1])))
    # Alike all around, the rooms may be one room and 3.2 m the drift: the loop waits.
    assert events == [LoopEvent.NOTHING, LoopEvent.NOTHING]


@pytest.mark.parametrize('drift_m', [0.8, 1.5])
def test_a_drift_that_no_loop_has_shown_is_corrected_where_the_map_contradicts_it(
    drift_m: float,
) -> None:
    room, elsewhere, shift, away = ring_poses(36), ring_poses(150), np.eye(4), np.eye(4)
    shift[0, 3], away[0, 3] = drift_m, 100.0
    atlas = Atlas(1.2, 8)
    mapped(atlas, RingWorld(), room, room)
    mapped(atlas, RingWorld(300, seed=1), elsewhere, away @ elsewhere)
    rows = mapped(atlas, RingWorld(), room, shift @ room)
    assert LoopCloser(atlas, CAMERA, SlamConfig()).process(int(rows[-1])) is LoopEvent.CLOSED


def test_a_place_that_fits_where_it_is_is_not_moved_to_one_that_looks_alike() -> None:
    """Two rooms that look alike, 1.5 m apart; the camera comes back into the second one."""
    room, elsewhere, beside, away = ring_poses(36), ring_poses(150), np.eye(4), np.eye(4)
    beside[0, 3], away[0, 3] = 1.5, 100.0
    atlas = Atlas(1.2, 8)
    first = mapped(atlas, RingWorld(), room, beside @ room)
    mapped(atlas, RingWorld(), room, room)
    mapped(atlas, RingWorld(300, seed=1), elsewhere, away @ elsewhere)
    rows = mapped(atlas, RingWorld(), room, room)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    closer.process(int(rows[-1]))
    join = closer.last_join
    assert join is None or join.place_uid not in atlas.keyframes.uid[first]
    assert _errors_m(atlas, rows, room).max() < 0.02


@pytest.mark.parametrize(('apart_m', 'is_verified'), [(6.1, True), (20.0, False)])
def test_a_place_that_no_drift_reaches_is_not_verified(
    apart_m: float, is_verified: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A corridor that looks the same again after some meters: the path is as short as that."""
    room, away, atlas = ring_poses(36), np.eye(4), Atlas(1.2, 8)
    away[0, 3] = apart_m
    first = mapped(atlas, RingWorld(), room, room)
    rows = mapped(atlas, RingWorld(), room, away @ room)
    atlas.set_parent(int(rows[0]), int(first[0]))
    tried, verify = list[int](), PlaceVerifier.verify

    def count(verifier: PlaceVerifier, frame: Frame, candidate: int) -> PlaceMatch | None:
        tried.append(candidate)
        return verify(verifier, frame, candidate)

    monkeypatch.setattr(PlaceVerifier, 'verify', count)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    assert closer.process(int(rows[0])) is LoopEvent.NOTHING
    assert bool(tried) is is_verified


def test_a_closed_loop_is_not_closed_again(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, _ = drifting
    atlas = _copy(original)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    closer.process(int(rows[-1]))
    assert closer.process(int(rows[-1])) is LoopEvent.NOTHING


@pytest.mark.parametrize(
    ('long_path_m', 'event'), [(5.0, LoopEvent.CLOSED), (50.0, LoopEvent.REJOINED)]
)
def test_a_long_loop_is_adjusted_though_its_ends_fit(
    long_path_m: float, event: LoopEvent, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LoopConfig, 'long_path_m', long_path_m)
    truth, atlas = ring_poses(36, LAPS), Atlas(1.2, 8)
    rows = mapped(atlas, RingWorld(), truth, drifted(truth, 0.05 * DRIFT))
    assert _errors_m(atlas, rows, truth).max() < 0.03
    assert LoopCloser(atlas, CAMERA, SlamConfig()).process(int(rows[-1])) is event


def test_a_map_with_a_loop_that_has_grown_is_adjusted_once_more_in_the_end(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, truth = drifting
    atlas = _copy(original)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    closer.process(int(rows[-1]))
    middle = rows[len(rows) // 2]
    bent = atlas.keyframes.T_map_camera[middle].copy()
    bent[:3, 3] += 0.02
    atlas.set_poses(np.array([middle]), bent[None])
    closer.settle(0.0)
    np.testing.assert_array_equal(atlas.keyframes.T_map_camera[middle], bent)
    closer.process(int(rows[-1]))
    closer.settle(0.0)
    assert _errors_m(atlas, rows, truth)[len(rows) // 2] < 0.01


def test_more_drift_than_the_path_explains_is_no_loop(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, _ = drifting
    atlas = _copy(original)
    half = rows[len(rows) // 2 :]
    shift = np.eye(4)
    shift[0, 3] = 1.5
    atlas.set_poses(half, shift @ atlas.keyframes.T_map_camera[half])
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    assert closer.process(int(rows[-1])) is LoopEvent.NOTHING


def test_drift_far_beyond_that_of_the_loops_so_far_is_unusual() -> None:
    limit = DriftLimit(LoopConfig())
    assert limit.is_usual(180.0, np.deg2rad(12.9), 0.99)  # 4 + 9 degrees, 0.1 + 0.9 m
    assert not limit.is_usual(180.0, 0.0, 1.1)  # nothing is known of the camera
    assert not limit.is_usual(180.0, np.pi, 0.0)
    limit.add(5.0, 0.0, 0.0)
    for path_m in (60.0, 150.0, 250.0):
        limit.add(path_m, 0.0001 * path_m, 0.001 * path_m)
    assert limit.explains(180.0, 1.0, 1.5)
    assert not limit.is_usual(180.0, 0.0, 1.5)
    assert not limit.is_usual(180.0, 1.0, 0.0)
    assert limit.is_usual(180.0, np.deg2rad(12.9), 0.99)  # 4 + 9 degrees, 0.1 + 0.9 m
    limit.add(100.0, 0.2, 1.0)
    assert limit.is_usual(180.0, 1.0, 1.5)
    assert not limit.is_usual(180.0, 1.0, 3.2)  # as far as a room that looks alike may be


def test_loops_can_be_switched_off(drifting: tuple[Atlas, IntArray, FloatArray]) -> None:
    original, rows, _ = drifting
    config = SlamConfig().updated({'places.loops.enabled': False})
    closer = LoopCloser(_copy(original), CAMERA, config)
    assert closer.process(int(rows[-1])) is LoopEvent.NOTHING


def test_the_path_between_keyframes_follows_shared_points(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    atlas, rows, truth = drifting
    lap_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    lap_rad = 2 * np.pi * LAPS * (len(rows) - 1) / len(rows)
    way_m = path_length_m(atlas, int(rows[0]), int(rows[-1]))
    assert way_m == pytest.approx(lap_m + 0.3 * lap_rad, rel=0.1)


def test_points_follow_their_keyframe_through_a_correction(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, truth = drifting
    atlas = _copy(original)
    keyframes, points = atlas.keyframes, atlas.points
    i, k = rows[10], np.flatnonzero(keyframes.point_of_feature[rows[10]] >= 0)
    j = keyframes.point_of_feature[i, k].astype(np.int64)
    own = points.reference_keyframe_uid[j] == keyframes.uid[i]
    seen_before = se3.transform(se3.inverse(keyframes.T_map_camera[i]), points.position_m[j])
    move_map(atlas, rows, truth)
    seen_after = se3.transform(se3.inverse(truth[10]), points.position_m[j])
    assert own.sum() > 5
    np.testing.assert_allclose(seen_after[own], seen_before[own], atol=1e-9)


def test_hundreds_of_loops_leave_rotations_and_positions_finite(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, _ = drifting
    atlas, moved = _copy(original), np.empty((len(rows), 4, 4))
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


def test_a_loop_edge_moves_the_end_to_where_it_was_measured(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    atlas, rows, truth = drifting
    uid = atlas.keyframes.uid
    T_first_last = se3.inverse(truth[0]) @ truth[-1]
    loop = _edge(int(uid[rows[0]]), int(uid[rows[-1]]), T_first_last)
    region = region_around(atlas, rows[[0, -1]], len(rows))
    assert len(region.border) == 0
    keyframes, T = closed_poses(atlas, region, [loop], 100)
    assert keyframes.tolist() == sorted(rows.tolist())
    last = T[keyframes.tolist().index(int(rows[-1]))]
    np.testing.assert_allclose(last[:3, 3], truth[-1, :3, 3], atol=0.01)
    np.testing.assert_allclose(T[keyframes.tolist().index(int(rows[0]))], truth[0], atol=1e-9)


def test_the_uncertainty_of_a_loop_is_that_of_its_end_and_not_of_the_head_of_a_group(
    drifting: tuple[Atlas, IntArray, FloatArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The position of the end is measured well and its rotation badly, by 0.2 rad."""
    monkeypatch.setattr('rgbd_slam.loops.keyframe_groups._MAX_NODES', 6)
    atlas, rows, truth = drifting
    uid = atlas.keyframes.uid
    turned = truth[-1] @ se3.exp(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    covariance = np.diag(np.square([0.2] * 3 + [0.001] * 3))
    loop = _edge(int(uid[rows[0]]), int(uid[rows[-1]]), se3.inverse(truth[0]) @ turned, covariance)
    region = region_around(atlas, rows[[0, -1]], len(rows))
    keyframes, T = closed_poses(atlas, region, [loop], 100)
    last = T[keyframes.tolist().index(int(rows[-1]))]
    np.testing.assert_allclose(last[:3, 3], truth[-1, :3, 3], atol=0.02)


def test_a_loop_that_contradicts_the_others_is_left_out_and_kept_with_its_evidence(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, truth = drifting
    for order in (1, -1):  # the wrong one is the newest, or the oldest
        atlas, uid = _copy(original), original.keyframes.uid[rows].tolist()
        true = [
            _edge(uid[a], uid[b], se3.inverse(truth[a]) @ truth[b]) for a, b in ((0, -1), (1, -2))
        ]
        T_wrong = se3.inverse(truth[0]) @ truth[-1]
        T_wrong[0, 3] += 2.0
        edges = [*true, _edge(uid[0], uid[-1], T_wrong)][::order]
        atlas.loops = tuple(edges)
        region = region_around(atlas, rows[[0, -1]], len(rows))
        graph = optimized(atlas, region, 100)
        used = [edge.is_used for edge in graph.loops]
        assert used == [True, True, False][::order]
        assert graph.loops[np.argmin(used)].residual_m == pytest.approx(2.0, abs=0.05)
        assert max(edge.residual_m for edge in graph.loops if edge.is_used) < 0.02
        move_map(atlas, region.rows, graph.T_map_camera)
        assert _errors_m(atlas, rows, truth).max() < 0.1  # of 0.2 m


def test_a_closed_loop_is_in_the_map_with_its_evidence_and_in_its_copies(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, _ = drifting
    atlas, copy, resumed = _copy(original), _copy(original), Atlas(1.2, 8)
    version = atlas.version
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    closer.process(int(rows[-1]))
    (edge,) = atlas.loops
    assert closer.last_join is not None
    assert (edge.kind, edge.is_used) == ('closed', True)
    assert edge.num_inliers == closer.last_join.num_points
    assert edge.second_uid == atlas.keyframes.uid[rows[-1]]
    assert edge.found_share > 0.9
    assert edge.residual_m < 0.03
    copy.apply(atlas.changes_since(version))
    resumed.apply(atlas.whole())
    assert copy.loops == resumed.loops == atlas.loops
    assert atlas.changes_since(atlas.version).loops is None  # it has not changed


def test_a_wrong_loop_is_taken_back_with_the_points_that_it_has_fused(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, truth = drifting
    atlas, uid = _copy(original), original.keyframes.uid[rows].tolist()
    keyframes = atlas.keyframes
    wrong = _edge(uid[5], uid[30], np.eye(4))
    atlas.loops = (_edge(uid[0], uid[-1], se3.inverse(truth[0]) @ truth[-1]), wrong)
    seen, other = (np.setdiff1d(keyframes.points_of(int(rows[n])), [-1]) for n in (5, 30))
    count = min(len(seen), len(other), 80)
    atlas.replace_points(other[:count], seen[:count])
    atlas.refresh(seen[:count])
    atlas.update_connections(int(rows[30]))
    region = region_around(atlas, rows[[5, 30]], len(rows))
    move_map(atlas, *closed_poses(atlas, region, atlas.loops, 100))
    atlas.set_parent(int(rows[31]), int(rows[6]))  # tracked from the wrong place
    assert _errors_m(atlas, rows, truth).max() > 0.5

    LoopCloser(atlas, CAMERA, SlamConfig()).open(1)

    assert [edge[:2] for edge in atlas.loops] == [(uid[0], uid[-1])]
    assert _errors_m(atlas, rows, truth).max() < 0.03
    first, second = (keyframes.points_of(int(rows[n])) for n in (5, 30))
    common = np.intersect1d(first, second)
    assert (common == -1).all()
    assert keyframes.parent_uid[rows[31]] == uid[30]


def test_two_maps_that_were_joined_wrongly_are_separate_again() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(24, 0.5)
    old = mapped(atlas, RingWorld(), truth[:12], truth[:12])
    new = mapped(atlas, RingWorld(seed=3), truth[12:], truth[12:], map_id=1)
    keyframes, T_old = atlas.keyframes, atlas.keyframes.T_map_camera[old]
    c, i = int(old[3]), int(new[4])
    ends = int(keyframes.uid[c]), int(keyframes.uid[i])
    atlas.loops = (_edge(ends[0], ends[1], np.eye(4))._replace(kind='merged'),)
    merge_maps(atlas, i, c, np.eye(4))
    assert len(np.unique(keyframes.map_id[np.r_[old, new]])) == 1

    LoopCloser(atlas, CAMERA, SlamConfig()).open(0)

    assert not atlas.loops
    (id_old,), (id_new,) = (np.unique(keyframes.map_id[rows]) for rows in (old, new))
    assert id_old != id_new
    np.testing.assert_allclose(keyframes.T_map_camera[old], T_old, atol=0.01)
    roots = ~np.isin(keyframes.parent_uid[np.r_[old, new]], keyframes.uid[np.r_[old, new]])
    assert roots.sum() == 2
    assert restore(Atlas(1.2, 8), snapshot(atlas), CAMERA, keep=False) is not None


def test_a_loop_outlives_its_keyframes_and_is_saved(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    original, rows, _ = drifting
    atlas, uid = _copy(original), original.keyframes.uid[rows].tolist()
    T = atlas.keyframes.T_map_camera[rows]
    atlas.loops = (_edge(uid[2], uid[-2], se3.inverse(T[2]) @ T[-2]),)
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


def test_a_loop_in_a_large_map_corrects_the_keyframes_around_it(
    drifting: tuple[Atlas, IntArray, FloatArray],
) -> None:
    atlas, rows, truth = drifting
    region = region_around(atlas, rows[[0, -1]], 9)
    assert len(region.rows) == 9
    assert len(region.border) > 0
    assert not np.isin(region.border, region.rows).any()
    uid = atlas.keyframes.uid[rows]
    loop = _edge(int(uid[0]), int(uid[-1]), se3.inverse(truth[0]) @ truth[-1])
    keyframes, T = closed_poses(atlas, region, [loop], 100)
    assert keyframes.tolist() == region.rows.tolist()
    before = atlas.keyframes.T_map_camera[rows[-1]]
    after = T[keyframes.tolist().index(int(rows[-1]))]
    drift_m = np.linalg.norm(before[:3, 3] - truth[-1, :3, 3])
    assert np.linalg.norm(after[:3, 3] - truth[-1, :3, 3]) < 0.8 * drift_m


def test_two_maps_become_one_in_the_frame_of_the_older() -> None:
    world, atlas = RingWorld(), Atlas(1.2, 8)
    truth = ring_poses(24, 0.5)
    T_other = se3.exp(np.array([0.3, -1.0, 0.2, 2.0, 0.5, -1.0]))
    old = mapped(atlas, world, truth[:14], truth[:14])
    new = mapped(atlas, world, truth[10:], T_other @ truth[10:], map_id=1)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    events = [closer.process(int(i)) for i in new]
    assert events.count(LoopEvent.MERGED) == 1
    keyframes = atlas.keyframes
    assert set(keyframes.map_id[np.r_[old, new]].tolist()) == {0}
    assert (atlas.points.map_id[atlas.points.indices()] == 0).all()
    assert _errors_m(atlas, new, truth[10:]).max() < 0.02
    alive = keyframes.indices()
    roots = ~np.isin(keyframes.parent_uid[alive], keyframes.uid[alive])
    assert roots.sum() == 1


def test_the_older_map_keeps_its_frame_whichever_side_recognizes() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(12, 0.2)
    T_other = se3.exp(np.array([0.0, 0.5, 0.0, 1.0, 0.0, 0.0]))
    old = mapped(atlas, RingWorld(), truth[:6], truth[:6])
    new = mapped(atlas, RingWorld(), truth[6:], T_other @ truth[6:], map_id=1)
    merge_maps(atlas, int(old[5]), int(new[2]), se3.inverse(truth[8]) @ truth[5])
    np.testing.assert_allclose(atlas.keyframes.T_map_camera[new], truth[6:], atol=1e-9)
    np.testing.assert_allclose(atlas.keyframes.T_map_camera[old], truth[:6], atol=1e-12)
    assert atlas.keyframes.parent_uid[new[2]] == atlas.keyframes.uid[old[5]]
    assert atlas.keyframes.parent_uid[new[0]] == atlas.keyframes.uid[new[1]]


def test_a_lost_frame_is_located() -> None:
    world, atlas = RingWorld(), Atlas(1.2, 8)
    truth = ring_poses(24)
    mapped(atlas, world, truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    between = truth[7] @ se3.exp(np.array([0.02, 0.1, 0.05, 0.1, 0.05, -0.1]))
    place = finder.locate(world.frame(between, 99)[0])
    assert place is not None
    np.testing.assert_allclose(place.match.T_map_camera, between, atol=5e-3)


def test_a_foreign_view_is_not_located() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(24)
    mapped(atlas, RingWorld(), truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    assert finder.locate(RingWorld(seed=5).frame(truth[3], 99)[0]) is None


def test_of_two_identical_places_neither_is_returned() -> None:
    world, atlas = RingWorld(count=1500), Atlas(1.2, 8)
    half_turn = np.array([-1.0, 1.0, -1.0])
    world.points_m = np.concatenate([world.points_m, half_turn * world.points_m])
    world.descriptors = np.tile(world.descriptors, (2, 1))
    truth = ring_poses(24)
    mapped(atlas, world, truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    assert finder.locate(world.frame(truth[3], 99)[0]) is None
