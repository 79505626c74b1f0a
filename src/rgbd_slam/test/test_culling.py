"""Culling of points and keyframes in maps with known results."""

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import MappingConfig
from rgbd_slam.local_mapping.culling import cull_keyframes, cull_new_points
from rgbd_slam.model.atlas import Atlas
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


def points_of(atlas: Atlas, i: int, count: int) -> IntArray:
    return atlas.add_points(i, np.arange(count), np.full((count, 3), 2.0))


def later(atlas: Atlas, count: int, *, depth_m: float = 2.0, octave: int = 0) -> list[int]:
    """Add keyframes without observations whose parent is the first keyframe; return their rows."""
    return [
        atlas.add_keyframe(frame_at(10 + n, depth_m, octave), np.eye(4), 0, 0)
        for n in range(count)
    ]


@pytest.mark.parametrize(('found', 'stays'), [(2, False), (3, True), (12, True)])
def test_new_points_that_frames_do_not_find_are_removed(found: int, stays: bool) -> None:
    atlas = Atlas(1.2, 8)
    i = atlas.add_keyframe(frame_at(1), np.eye(4), 0)
    j = points_of(atlas, i, 5)
    atlas.points.num_visible[j] = 12
    atlas.points.num_found[j] = found  # a quarter is asked for
    cull_new_points(atlas, CAMERA, i, CONFIG)
    assert atlas.points.alive[j].tolist() == [stays] * 5


@pytest.mark.parametrize(
    ('depth_m', 'observers', 'age', 'stays'),
    [
        (2.0, 1, 1, True),  # too young to be culled
        (2.0, 1, 2, False),  # seen once, with depth: weight 2
        (2.0, 2, 2, True),  # weight 4
        (0.0, 3, 3, False),  # three without depth: weight 3
        (0.0, 4, 3, True),
        (2.0, 1, 4, False),  # still in view, and still not seen
    ],
)
def test_new_points_that_keyframes_do_not_observe_are_removed(
    depth_m: float, observers: int, age: int, stays: bool
) -> None:
    atlas = Atlas(1.2, 8)
    first = atlas.add_keyframe(frame_at(1, depth_m), np.eye(4), 0)
    j = points_of(atlas, first, 3)
    rows = later(atlas, max(age, observers - 1), depth_m=depth_m)
    for i in rows[: observers - 1]:
        atlas.observe(i, np.arange(3), j)
    cull_new_points(atlas, CAMERA, rows[age - 1], CONFIG)
    assert atlas.points.alive[j].tolist() == [stays] * 3


def test_points_out_of_view_are_tested_when_they_are_in_view_again() -> None:
    atlas = Atlas(1.2, 8)
    j = points_of(atlas, atlas.add_keyframe(frame_at(1), np.eye(4), 0), 3)
    away = se3.exp(np.array([0, np.pi, 0, 0, 0, 0]))
    for n in range(6):
        i = atlas.add_keyframe(frame_at(2 + n), away, 0, 0)
        cull_new_points(atlas, CAMERA, i, CONFIG)
        assert atlas.points.alive[j].all()
    back = atlas.add_keyframe(frame_at(10), np.eye(4), 0, 0)
    atlas.observe(back, np.arange(1), j[:1])
    cull_new_points(atlas, CAMERA, back, CONFIG)
    assert atlas.points.alive[j].tolist() == [True, False, False]


def test_points_of_another_map_are_left_alone() -> None:
    atlas = Atlas(1.2, 8)
    j = points_of(atlas, atlas.add_keyframe(frame_at(1), np.eye(4), 0), 3)
    for n in range(4):
        i = atlas.add_keyframe(frame_at(2 + n), np.eye(4), 1)
    cull_new_points(atlas, CAMERA, i, CONFIG)
    assert atlas.points.alive[j].all()


def seen_by_all(
    share: float, observers: int = 4, *, depth_m: float = 2.0, octave: int = 0
) -> tuple[Atlas, list[int]]:
    """Return a map and its keyframes; others observe a share of the points of the second one."""
    atlas = Atlas(1.2, 8)
    root = atlas.add_keyframe(frame_at(1), np.eye(4), 0)
    judged = atlas.add_keyframe(frame_at(2, depth_m), np.eye(4), 0, root)
    j = points_of(atlas, judged, FEATURES)
    rows = later(atlas, observers, octave=octave)
    for i in rows:
        atlas.observe(i, np.arange(round(share * FEATURES)), j[: round(share * FEATURES)])
        # And as much again of its own, so that it is not redundant itself.
        own = np.arange(round(share * FEATURES), FEATURES)
        atlas.add_points(i, own, np.full((len(own), 3), 3.0))
    for i in [root, judged, *rows]:
        atlas.update_connections(i)
    return atlas, [root, judged, *rows]


def test_a_keyframe_is_removed_when_three_others_observe_most_of_it() -> None:
    config = replace(CONFIG, redundant_share=0.6)
    for share, stays in ((0.55, True), (0.65, False)):
        atlas, rows = seen_by_all(share)
        seen = atlas.keyframes.point_of_feature[rows[-1]].copy()
        cull_keyframes(atlas, rows[-1], config, CLOSE_M)
        assert bool(atlas.keyframes.alive[rows[1]]) is stays
        assert atlas.keyframes.alive[rows[0]]
        np.testing.assert_array_equal(atlas.keyframes.point_of_feature[rows[-1]], seen)


@pytest.mark.parametrize('depth_m', [8.0, 0.0])
def test_a_redundant_keyframe_without_close_points_is_removed(depth_m: float) -> None:
    for share, stays in ((0.55, True), (0.95, False)):
        atlas, rows = seen_by_all(share, depth_m=depth_m)
        cull_keyframes(atlas, rows[-1], replace(CONFIG, redundant_share=0.6), CLOSE_M)
        assert bool(atlas.keyframes.alive[rows[1]]) is stays


def test_two_others_are_not_enough() -> None:
    atlas, rows = seen_by_all(1.0, observers=2)
    cull_keyframes(atlas, rows[-1], CONFIG, CLOSE_M)
    assert atlas.keyframes.alive[rows].all()


def test_coarser_observations_do_not_count() -> None:
    atlas, rows = seen_by_all(1.0, octave=2)
    cull_keyframes(atlas, rows[-1], CONFIG, CLOSE_M)
    assert atlas.keyframes.alive[rows[1]]


def test_the_root_of_a_map_stays() -> None:
    atlas, rows = seen_by_all(1.0)
    atlas.keyframes.parent_uid[rows[1]] = -1
    cull_keyframes(atlas, rows[-1], CONFIG, CLOSE_M)
    assert atlas.keyframes.alive[rows[1]]
