"""Loops are closed where the map has drifted, and not where two places look alike."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from hoid_common import se3
from rgbd_slam.config.place_config import LoopConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.essential_graph import closed_poses, move_map, region_around
from rgbd_slam.loops.loop_closer import Join, LoopCloser, LoopEvent
from rgbd_slam.loops.loop_detection import DriftLimit, are_same_poses
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceVerifier
from rgbd_slam.places.place_finder import Candidate

from .drifting_ring import DRIFT, LAPS, drifting_map, errors_m, loop_edge
from .ring_world import CAMERA, RingWorld, drifted, mapped, ring_poses


def test_a_loop_is_closed_and_the_drift_is_gone(caplog: pytest.LogCaptureFixture) -> None:
    atlas, rows, truth = drifting_map()
    before = errors_m(atlas, rows, truth)
    points_before = len(atlas.points)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    with caplog.at_level('INFO', 'rgbd_slam.loops.loop_closer'):
        assert closer.process(int(rows[-1])) is LoopEvent.CLOSED
    (join,) = (join for record in caplog.records for join in record.args or ())
    assert isinstance(join, Join)
    assert (join.event, join.stamp_ns) == (LoopEvent.CLOSED, atlas.keyframes.stamp_ns[rows[-1]])
    place = atlas.keyframes.stamp_ns[rows].tolist().index(join.place_stamp_ns)
    T_place_camera = se3.inverse(truth[place]) @ truth[-1]
    np.testing.assert_allclose(join.edge.T_first_second, T_place_camera, atol=0.01)
    after = errors_m(atlas, rows, truth)
    assert before.max() > 0.1
    assert after.max() < 0.15 * before.max()
    assert len(atlas.points) < points_before - 100  # seen twice, one point now
    assert rows[0] in atlas.covisible(rows[-1], min_shared=51)


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
    assert join is None or join.edge.first_uid not in atlas.keyframes.uid[first]
    assert errors_m(atlas, rows, room).max() < 0.02


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


def test_a_closed_loop_is_not_closed_again() -> None:
    atlas, rows, _ = drifting_map()
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
    assert errors_m(atlas, rows, truth).max() < 0.03
    assert LoopCloser(atlas, CAMERA, SlamConfig()).process(int(rows[-1])) is event


def test_a_map_with_a_loop_that_has_grown_is_adjusted_once_more_in_the_end() -> None:
    atlas, rows, truth = drifting_map()
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
    assert errors_m(atlas, rows, truth)[len(rows) // 2] < 0.01


@pytest.mark.parametrize(('depth_m', 'are_same'), [(1.0, False), (4.0, True)])
def test_a_confirming_pose_may_differ_more_if_its_points_are_far(
    depth_m: float, are_same: bool
) -> None:
    points_m = np.random.default_rng(0).normal((0.0, 0.0, depth_m), 0.1, (50, 3))
    aside = se3.exp(np.array([0.0, 0.0, 0.0, 0.08, 0.0, 0.0]))
    assert are_same_poses(aside, np.eye(4), points_m) is are_same


def test_more_drift_than_the_path_explains_is_no_loop(caplog: pytest.LogCaptureFixture) -> None:
    atlas, rows, _ = drifting_map()
    half = rows[len(rows) // 2 :]
    shift = np.eye(4)
    shift[0, 3] = 1.5
    atlas.set_poses(half, shift @ atlas.keyframes.T_map_camera[half])
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    with caplog.at_level(logging.DEBUG, 'rgbd_slam'):
        assert closer.process(int(rows[-1])) is LoopEvent.NOTHING
    candidates = [
        c for record in caplog.records for c in record.args or () if isinstance(c, Candidate)
    ]
    assert candidates
    assert not any(candidate.is_in_other_map for candidate in candidates)
    assert any(candidate.doubt.startswith('drift limit: ') for candidate in candidates)


@pytest.mark.parametrize(('blurred', 'event'), [(None, LoopEvent.NOTHING), (18, LoopEvent.CLOSED)])
def test_more_drift_is_a_loop_where_the_path_leads_over_a_blurred_keyframe(
    blurred: int | None, event: LoopEvent
) -> None:
    """The second half is turned about its end by 18 degrees, 6 more than the path explains."""
    truth, atlas = ring_poses(36, LAPS), Atlas(1.2, 8)
    turn, about = se3.exp(np.deg2rad([0.0, 18.0, 0.0, 0.0, 0.0, 0.0])), np.eye(4)
    about[:3, 3] = truth[-1, :3, 3]
    poses = truth.copy()
    poses[18:] = about @ turn @ se3.inverse(about) @ truth[18:]
    rows = mapped(atlas, RingWorld(), truth, poses, blurred=blurred)
    before_m = errors_m(atlas, rows, truth).max()
    assert LoopCloser(atlas, CAMERA, SlamConfig()).process(int(rows[-1])) is event
    if blurred is not None:
        assert errors_m(atlas, rows, truth).max() < 0.2 * before_m


def test_drift_far_beyond_that_of_the_loops_so_far_is_unusual() -> None:
    limit = DriftLimit(LoopConfig())
    assert limit.is_usual(180.0, np.deg2rad(12.9), 0.99)  # 4 + 9 degrees, 0.1 + 0.9 m
    assert not limit.is_usual(180.0, 0.0, 1.1)  # nothing is known of the camera
    assert not limit.is_usual(180.0, np.pi, 0.0)
    limit.learn(5.0, 0.0, 0.0)
    for path_m in (60.0, 150.0, 250.0):
        limit.learn(path_m, 0.0001 * path_m, 0.001 * path_m)
    assert limit.is_possible(180.0, 1.0, 1.5)
    assert not limit.is_usual(180.0, 0.0, 1.5)
    assert not limit.is_usual(180.0, 1.0, 0.0)
    assert limit.is_usual(180.0, np.deg2rad(12.9), 0.99)  # 4 + 9 degrees, 0.1 + 0.9 m
    limit.learn(100.0, 0.2, 1.0)
    assert limit.is_usual(180.0, 1.0, 1.5)
    assert not limit.is_usual(180.0, 1.0, 3.2)  # as far as a room that looks alike may be


def test_loops_can_be_switched_off() -> None:
    atlas, rows, _ = drifting_map()
    config = SlamConfig().updated({'places.loops.enabled': False})
    closer = LoopCloser(atlas, CAMERA, config)
    assert closer.process(int(rows[-1])) is LoopEvent.NOTHING


def test_a_closed_loop_is_in_the_map_with_its_evidence_and_in_its_copies() -> None:
    atlas, rows, _ = drifting_map()
    (copy, *_), resumed = drifting_map(), Atlas(1.2, 8)
    version = atlas.version
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    closer.process(int(rows[-1]))
    (edge,) = atlas.loops
    assert closer.last_join is not None
    assert (edge.kind, edge.is_used) == ('closed', True)
    assert edge == closer.last_join.edge
    assert edge.second_uid == atlas.keyframes.uid[rows[-1]]
    assert edge.found_share > 0.9
    assert edge.residual_m < 0.03
    copy.apply(atlas.changes_since(version))
    resumed.apply(atlas.whole())
    assert copy.loops == resumed.loops == atlas.loops
    assert atlas.changes_since(atlas.version).loops is None  # it has not changed


def test_a_wrong_loop_is_taken_back_with_the_points_that_it_has_fused() -> None:
    atlas, rows, truth = drifting_map()
    uid = atlas.keyframes.uid[rows].tolist()
    keyframes = atlas.keyframes
    wrong = loop_edge(uid[5], uid[30], np.eye(4))
    atlas.loops = (loop_edge(uid[0], uid[-1], se3.inverse(truth[0]) @ truth[-1]), wrong)
    seen, other = (np.setdiff1d(keyframes.points_of(int(rows[n])), [-1]) for n in (5, 30))
    count = min(len(seen), len(other), 80)
    atlas.replace_points(other[:count], seen[:count])
    atlas.refresh(seen[:count])
    atlas.update_connections(int(rows[30]))
    region = region_around(atlas, rows[[5, 30]], len(rows))
    move_map(atlas, region.rows, closed_poses(atlas, region, atlas.loops, 100))
    atlas.set_parent(int(rows[31]), int(rows[6]))  # tracked from the wrong place
    assert errors_m(atlas, rows, truth).max() > 0.5

    LoopCloser(atlas, CAMERA, SlamConfig()).remove(1)

    assert [edge[:2] for edge in atlas.loops] == [(uid[0], uid[-1])]
    assert errors_m(atlas, rows, truth).max() < 0.03
    first, second = (keyframes.points_of(int(rows[n])) for n in (5, 30))
    common = np.intersect1d(first, second)
    assert (common == -1).all()
    assert keyframes.parent_uid[rows[31]] == uid[30]
