"""The local map of a frame lies around the points that the frame observes."""

from __future__ import annotations

import numpy as np

from hoid_common.values import IntArray
from rgbd_slam.matching.local_map import find_local_map
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame

POINTS = 50  # that each view shows
LIMIT = 10


def frame() -> Frame:
    return Frame(
        0,
        np.full((POINTS, 3), 100.0, np.float32),
        np.full(POINTS, 2.0, np.float32),
        np.zeros(POINTS, np.uint8),
        np.zeros(POINTS, np.float32),
        np.zeros((POINTS, 32), np.uint8),
        np.ones(POINTS, np.bool_),
    )


def two_views() -> tuple[Atlas, IntArray]:
    """Return a map whose keyframe 0 sees other points than 1 and 2, and the points of those."""
    atlas = Atlas(1.2, 8)
    every = np.arange(POINTS)
    for parent in (None, 0, 1):
        atlas.add_keyframe(frame(), np.eye(4), 0, parent)
    atlas.add_points(0, every, np.full((POINTS, 3), 2.0))
    there = atlas.add_points(1, every, np.full((POINTS, 3), 5.0))
    atlas.observe(2, every, there)
    atlas.update_connections(1)
    return atlas, there


def test_the_reference_keyframe_observes_most_of_the_points() -> None:
    atlas, there = two_views()
    uid = atlas.keyframes.uid
    atlas.unobserve(2, np.arange(10))
    found = find_local_map(atlas, there, int(uid[2]), LIMIT)
    assert found.reference_uid == uid[1]
    assert found.points.tolist() == there.tolist()


def test_a_removed_reference_keyframe_whose_ancestor_looks_elsewhere_is_replaced() -> None:
    """Tracking must not stay with a removed keyframe, whose points it would lose for good."""
    atlas, there = two_views()
    uids = atlas.keyframes.uid.tolist()
    atlas.remove_keyframe(1)
    found = find_local_map(atlas, there, uids[1], LIMIT)
    assert found.reference_uid == uids[2]
    assert found.points.tolist() == there.tolist()


def test_without_observed_points_the_reference_keyframe_stays() -> None:
    atlas, there = two_views()
    uid = int(atlas.keyframes.uid[1])
    found = find_local_map(atlas, np.empty(0, np.int64), uid, LIMIT)
    assert (found.reference_uid, found.points.tolist()) == (uid, there.tolist())
