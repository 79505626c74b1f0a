"""Which points and keyframes leave the map, by rules whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import MappingConfig
from rgbd_slam.local_mapping.culling import cull_keyframes, cull_young_points
from rgbd_slam.model.atlas import SlamMap
from rgbd_slam.model.frame import Frame, StereoCamera

CONFIG = MappingConfig()
CAMERA = StereoCamera(100.0, 100.0, 200.0, 200.0, 8.0, 0.3, 0.0, (0.0, 0.0, 400.0, 400.0))
CLOSE_M = 3.0
FEATURES = 100


def frame_at(stamp_ns: int, depth_m: float = 2.0, octave: int = 0) -> Frame:
    pixel = np.random.default_rng(stamp_ns).uniform(0, 400, (FEATURES, 3)).astype(np.float32)
    return Frame(
        stamp_ns,
        pixel if depth_m else np.where([True, True, False], pixel, np.nan).astype(np.float32),
        np.full(FEATURES, depth_m, np.float32),
        np.full(FEATURES, octave, np.uint8),
        np.zeros(FEATURES, np.float32),
        np.zeros((FEATURES, 32), np.uint8),
        np.ones(FEATURES, np.bool_),
    )


def points_of(slam_map: SlamMap, i: int, count: int) -> IntArray:
    return slam_map.add_points(i, np.arange(count), np.full((count, 3), 2.0))


def later(slam_map: SlamMap, count: int, *, depth_m: float = 2.0, octave: int = 0) -> list[int]:
    """Add keyframes that see nothing yet, each hung on the first."""
    return [
        slam_map.add_keyframe(frame_at(10 + n, depth_m, octave), np.eye(4), 0, 0)
        for n in range(count)
    ]


@pytest.mark.parametrize(('found', 'stays'), [(2, False), (3, True), (12, True)])
def test_young_points_that_frames_do_not_find_go(found: int, stays: bool) -> None:
    slam_map = SlamMap(1.2, 8)
    i = slam_map.add_keyframe(frame_at(1), np.eye(4), 0)
    j = points_of(slam_map, i, 5)
    slam_map.points.num_visible[j] = 12
    slam_map.points.num_found[j] = found  # a quarter is asked for
    cull_young_points(slam_map, CAMERA, i, CONFIG)
    assert slam_map.points.alive[j].tolist() == [stays] * 5


@pytest.mark.parametrize(
    ('depth_m', 'observers', 'age', 'stays'),
    [
        (2.0, 1, 1, True),  # too young to be judged
        (2.0, 1, 2, False),  # seen once, with depth: weight 2
        (2.0, 2, 2, True),  # weight 4
        (0.0, 3, 3, False),  # three without depth: weight 3
        (0.0, 4, 3, True),
        (2.0, 1, 4, False),  # still in view, and still not seen
    ],
)
def test_young_points_that_keyframes_do_not_see_go(
    depth_m: float, observers: int, age: int, stays: bool
) -> None:
    slam_map = SlamMap(1.2, 8)
    first = slam_map.add_keyframe(frame_at(1, depth_m), np.eye(4), 0)
    j = points_of(slam_map, first, 3)
    rows = later(slam_map, max(age, observers - 1), depth_m=depth_m)
    for i in rows[: observers - 1]:
        slam_map.observe(i, np.arange(3), j)
    cull_young_points(slam_map, CAMERA, rows[age - 1], CONFIG)
    assert slam_map.points.alive[j].tolist() == [stays] * 3


def test_points_that_left_the_view_are_judged_when_it_comes_back() -> None:
    slam_map = SlamMap(1.2, 8)
    j = points_of(slam_map, slam_map.add_keyframe(frame_at(1), np.eye(4), 0), 3)
    away = se3.exp(np.array([0, np.pi, 0, 0, 0, 0]))
    for n in range(6):
        i = slam_map.add_keyframe(frame_at(2 + n), away, 0, 0)
        cull_young_points(slam_map, CAMERA, i, CONFIG)
        assert slam_map.points.alive[j].all()
    back = slam_map.add_keyframe(frame_at(10), np.eye(4), 0, 0)
    slam_map.observe(back, np.arange(1), j[:1])
    cull_young_points(slam_map, CAMERA, back, CONFIG)
    assert slam_map.points.alive[j].tolist() == [True, False, False]


def test_points_of_another_map_are_left_alone() -> None:
    slam_map = SlamMap(1.2, 8)
    j = points_of(slam_map, slam_map.add_keyframe(frame_at(1), np.eye(4), 0), 3)
    for n in range(4):
        i = slam_map.add_keyframe(frame_at(2 + n), np.eye(4), 1)
    cull_young_points(slam_map, CAMERA, i, CONFIG)
    assert slam_map.points.alive[j].all()


def seen_by_all(
    share: float, observers: int = 4, *, depth_m: float = 2.0, octave: int = 0
) -> tuple[SlamMap, list[int]]:
    """Return keyframes of which the second shares so much with `observers` others."""
    slam_map = SlamMap(1.2, 8)
    root = slam_map.add_keyframe(frame_at(1), np.eye(4), 0)
    judged = slam_map.add_keyframe(frame_at(2, depth_m), np.eye(4), 0, root)
    j = points_of(slam_map, judged, FEATURES)
    rows = later(slam_map, observers, octave=octave)
    for i in rows:
        slam_map.observe(i, np.arange(round(share * FEATURES)), j[: round(share * FEATURES)])
        # And as much again of its own, so that it is not redundant itself.
        own = np.arange(round(share * FEATURES), FEATURES)
        slam_map.add_points(i, own, np.full((len(own), 3), 3.0))
    for i in [root, judged, *rows]:
        slam_map.update_connections(i)
    return slam_map, [root, judged, *rows]


def test_a_keyframe_goes_when_three_others_see_most_of_it() -> None:
    config = replace(CONFIG, redundant_share=0.6)
    for share, stays in ((0.55, True), (0.65, False)):
        slam_map, rows = seen_by_all(share)
        seen = slam_map.keyframes.point_of_feature[rows[-1]].copy()
        cull_keyframes(slam_map, rows[-1], config, CLOSE_M)
        assert bool(slam_map.keyframes.alive[rows[1]]) is stays
        assert slam_map.keyframes.alive[rows[0]]
        np.testing.assert_array_equal(slam_map.keyframes.point_of_feature[rows[-1]], seen)


@pytest.mark.parametrize('depth_m', [8.0, 0.0])
def test_a_keyframe_of_a_hall_goes_as_well(depth_m: float) -> None:
    for share, stays in ((0.55, True), (0.95, False)):
        slam_map, rows = seen_by_all(share, depth_m=depth_m)
        cull_keyframes(slam_map, rows[-1], replace(CONFIG, redundant_share=0.6), CLOSE_M)
        assert bool(slam_map.keyframes.alive[rows[1]]) is stays


def test_two_others_are_not_enough() -> None:
    slam_map, rows = seen_by_all(1.0, observers=2)
    cull_keyframes(slam_map, rows[-1], CONFIG, CLOSE_M)
    assert slam_map.keyframes.alive[rows].all()


def test_those_who_see_it_more_coarsely_do_not_count() -> None:
    slam_map, rows = seen_by_all(1.0, octave=2)
    cull_keyframes(slam_map, rows[-1], CONFIG, CLOSE_M)
    assert slam_map.keyframes.alive[rows[1]]


def test_the_root_of_a_map_stays() -> None:
    slam_map, rows = seen_by_all(1.0)
    slam_map.keyframes.parent_uid[rows[1]] = -1
    cull_keyframes(slam_map, rows[-1], CONFIG, CLOSE_M)
    assert slam_map.keyframes.alive[rows[1]]
