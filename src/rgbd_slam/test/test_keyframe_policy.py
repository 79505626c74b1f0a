"""Frames become keyframes by the rules of the policy, in a map of known content."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import KeyframeConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.points import PointTally
from rgbd_slam.model.tracked_frame import tracked_frame
from rgbd_slam.optimize.pose_consensus import Consensus
from rgbd_slam.optimize.pose_optimizer import PoseEstimate
from rgbd_slam.tracking.keyframe_policy import KeyframePolicy
from rgbd_slam.tracking.tracker import TrackerOutput

CLOSE_PX = 10.0
FEATURES = 200
SEEN = 100  # of the features of each keyframe
DEPTH_M = 2.0
NOTHING = np.empty((3, 0))


def frame(stamp_ns: int = 0) -> Frame:
    """Return features all over the image, whose depth is near enough to create points."""
    u, v = np.meshgrid(np.arange(20) * 32.0, np.arange(10) * 48.0)
    pixel = np.stack([u.ravel(), v.ravel(), u.ravel() - 2 * CLOSE_PX], axis=1)
    return Frame(
        stamp_ns,
        pixel.astype(np.float32),
        np.full(FEATURES, DEPTH_M, np.float32),
        np.zeros(FEATURES, np.uint8),
        np.zeros(FEATURES, np.float32),
        np.zeros((FEATURES, 32), np.uint8),
        np.ones(FEATURES, np.bool_),
    )


def mapped(newer: int) -> Atlas:
    """Return a map with four keyframes that see the same points, and newer ones elsewhere."""
    atlas = Atlas(1.2, 8)
    i = atlas.add_keyframe(frame(), np.eye(4), 0)
    j = atlas.add_points(i, np.arange(SEEN), np.full((SEEN, 3), DEPTH_M))
    for n in range(3):
        other = atlas.add_keyframe(frame(1 + n), np.eye(4), 0, i)
        atlas.observe(other, np.arange(SEEN), j)
    atlas.update_connections(i)
    for n in range(newer):
        atlas.add_keyframe(frame(10 + n), np.eye(4), 0, i)
    return atlas


def tracking(
    atlas: Atlas,
    stamp_s: float,
    num_inliers: int,
    T_map_camera: FloatArray | None = None,
    expected_px: FloatArray = NOTHING,
    i: int = 0,
) -> TrackerOutput:
    T = np.eye(4) if T_map_camera is None else T_map_camera
    points = np.full(FEATURES, NO_POINT, np.int64)
    points[:num_inliers] = atlas.keyframes.point_of_feature[i, :num_inliers]
    seen = replace(frame(), stamp_ns=round(stamp_s * 1e9))
    tracked = tracked_frame(seen, T, points, atlas, int(atlas.keyframes.uid[i]))
    estimate = PoseEstimate(se3.inverse(T), np.ones(num_inliers, np.bool_), np.eye(6))
    none = np.empty(0, np.int64)
    tally = PointTally(none, points[:num_inliers])
    return TrackerOutput(tracked, Consensus(estimate), points, tally, expected_px, none, True)


def test_a_frame_becomes_a_keyframe_when_it_shows_less_of_the_reference() -> None:
    atlas = mapped(newer=0)
    policy = KeyframePolicy(atlas, KeyframeConfig(fewer_share=0.5), CLOSE_PX)

    def wants(stamp_s: float, num_inliers: int) -> bool:
        return policy.wants(tracking(atlas, stamp_s, num_inliers))

    assert not wants(0.5, 90)
    assert not wants(0.6, 76)  # 75 % of 100 points are asked for
    assert wants(0.7, 70)
    policy.inserted(1_000_000_000)
    assert not wants(1.05, 100)
    assert not wants(1.1, 70)  # so soon after the last one
    assert wants(1.15, 55)  # unless tracking falls


EVERYWHERE = frame().measurement_px.T.astype(np.float64)
LEFT_HALF = EVERYWHERE[:, EVERYWHERE[0] < 320]
FAR = EVERYWHERE * [[1.0], [1.0], [0.0]] + EVERYWHERE[0] * [[0.0], [0.0], [1.0]]


@pytest.mark.parametrize(
    ('newer', 'T_map_camera', 'expected_px', 'wanted'),
    [
        (10, se3.exp(np.array([0, 0.1, 0, 0.1, 0, 0])), EVERYWHERE, False),
        (5, np.eye(4), EVERYWHERE, True),  # the keyframes there are young
        (10, se3.exp(np.array([0, 0.3, 0, 0, 0, 0])), EVERYWHERE, True),  # another direction
        (10, se3.exp(np.array([0, 0, 0, 0.5, 0, 0])), EVERYWHERE, True),  # from elsewhere
        (10, np.eye(4), LEFT_HALF, True),  # somebody has left, and shows what was behind
        (10, np.eye(4), FAR, True),  # something was put there, in front of what is known
    ],
)
def test_a_view_that_the_map_knows_is_not_taken_in_again(
    newer: int, T_map_camera: FloatArray, expected_px: FloatArray, wanted: bool
) -> None:
    atlas = mapped(newer)
    policy = KeyframePolicy(atlas, KeyframeConfig(), CLOSE_PX)
    seen = tracking(atlas, 1.0, 40, T_map_camera, expected_px)
    assert policy.wants(seen) is wanted


def test_known_views_are_taken_in_where_asked_for() -> None:
    atlas = mapped(newer=10)
    config = KeyframeConfig(skip_known_views=False)
    seen = tracking(atlas, 1.0, 40, expected_px=EVERYWHERE)
    assert KeyframePolicy(atlas, config, CLOSE_PX).wants(seen)


def test_a_known_view_is_taken_in_when_tracking_falls() -> None:
    atlas = mapped(newer=10)
    policy = KeyframePolicy(atlas, KeyframeConfig(), CLOSE_PX)
    assert not policy.wants(tracking(atlas, 1.0, 100, expected_px=EVERYWHERE))
    assert policy.wants(tracking(atlas, 1.1, 55, expected_px=EVERYWHERE))


@pytest.mark.parametrize(('newer', 'wanted'), [(0, True), (10, False)])
def test_fewer_points_than_after_the_last_keyframe_are_enough_in_a_new_view(
    newer: int, wanted: bool
) -> None:
    """A new view needs a keyframe even if most points of the reference keyframe are tracked."""
    atlas = mapped(newer)
    policy = KeyframePolicy(atlas, KeyframeConfig(reference_share=0.5), CLOSE_PX)
    assert not policy.wants(tracking(atlas, 1.0, 100, expected_px=EVERYWHERE))
    assert not policy.wants(tracking(atlas, 1.1, 87, expected_px=EVERYWHERE))
    assert policy.wants(tracking(atlas, 1.2, 83, expected_px=EVERYWHERE)) is wanted


@pytest.mark.parametrize(
    ('moved_m', 'turned_rad', 'wanted'),
    [
        (0.0, 0.0, False),
        (0.08 * DEPTH_M, 0.0, False),
        (0.0, 0.25, True),
        (0.3 * DEPTH_M, 0.0, True),
    ],
)
def test_while_the_mapper_is_late_a_changed_view_becomes_a_keyframe(
    moved_m: float, turned_rad: float, wanted: bool
) -> None:
    atlas = mapped(newer=0)
    here = se3.exp(np.array([0.0, turned_rad, 0.0, moved_m, 0.0, 0.0]))
    newest = int(atlas.keyframes.uid[0])
    for uid in (100, 101):  # requested at the origin, not mapped yet
        atlas.pending[uid] = Redirect(uid, newest, np.eye(4))
        newest = uid
    policy = KeyframePolicy(atlas, KeyframeConfig(), CLOSE_PX)
    assert policy.wants(tracking(atlas, 9.0, 10, here)) is wanted


def test_a_frame_becomes_a_keyframe_although_its_reference_keyframe_was_removed() -> None:
    atlas = mapped(newer=0)
    policy = KeyframePolicy(atlas, KeyframeConfig(), CLOSE_PX)
    seen = tracking(atlas, 1.0, 40)
    removed = replace(seen.tracked, reference_uid=int(atlas.keyframes.uid[1]))
    atlas.remove_keyframe(1)
    assert policy.wants(replace(seen, tracked=removed))


@pytest.mark.parametrize(('num_inliers', 'wanted'), [(45, False), (35, True)])
def test_a_second_map_is_young_beside_a_large_one(num_inliers: int, wanted: bool) -> None:
    """Of its only keyframe, 40 % of the points are asked for, though each was observed once."""
    atlas = mapped(newer=10)
    i = atlas.add_keyframe(frame(30), np.eye(4), 1)
    atlas.add_points(i, np.arange(SEEN), np.full((SEEN, 3), DEPTH_M))
    policy = KeyframePolicy(atlas, KeyframeConfig(min_close_tracked=0), CLOSE_PX)
    assert policy.wants(tracking(atlas, 1.0, num_inliers, i=i)) is wanted
