"""Images that a driver sends twice: recognized, predicted, and not tracked as a standstill."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

from hoid_common.slam_status import SlamState
from hoid_common.values import Features, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.image_stream import RepeatedImages, Repetition

from .world import CAMERA, PERIOD_NS, World, position_errors_m, sway

POSES = sway(60)


def images(poses: FloatArray = POSES) -> list[Features]:
    world = World()
    return [world.features(n * PERIOD_NS, pose) for n, pose in enumerate(poses)]


def copy_of(features: Features, stamp_ns: int, *, new_depth: bool = True) -> Features:
    noise = np.float32(1.001) if new_depth else np.float32(1.0)
    return replace(features, stamp_ns=stamp_ns, depth_m=features.depth_m * noise)


def test_copies_are_recognized_by_the_positions_of_their_features() -> None:
    first, second = images()[:2]
    stream = RepeatedImages()
    assert stream.add(first) is Repetition.NOTHING
    fewer = copy_of(first, PERIOD_NS).select(np.arange(len(first)) % 3 > 0)  # by another mask
    assert stream.add(fewer) is Repetition.COLOR
    assert stream.add(copy_of(first, 2 * PERIOD_NS, new_depth=False)) is Repetition.ALL
    assert stream.num_repeated == 1
    assert stream.original_ns == 0
    assert stream.add(replace(second, stamp_ns=3 * PERIOD_NS)) is Repetition.NOTHING
    assert stream.original_ns == 3 * PERIOD_NS


def test_a_view_that_stays_the_same_is_a_camera_at_rest() -> None:
    first, stream = images()[0], RepeatedImages()
    found = [stream.add(copy_of(first, n * PERIOD_NS)) for n in range(20)]
    assert found.count(Repetition.NOTHING) == 3  # at 0, after 0.25 s and after 0.5 s
    no_features = first.select(np.zeros(len(first), np.bool_))
    assert stream.add(replace(no_features, stamp_ns=20 * PERIOD_NS)) is Repetition.NOTHING
    assert stream.add(replace(no_features, stamp_ns=21 * PERIOD_NS)) is Repetition.NOTHING


def test_every_second_image_is_a_copy(caplog: pytest.LogCaptureFixture) -> None:
    """As from a camera in the dark: poses of copies follow the motion, and all are published."""
    slam, shown = RgbdSlam(CAMERA, SlamConfig()), images()
    with caplog.at_level(logging.WARNING):
        results = [
            slam.process(shown[n] if n % 2 == 0 else copy_of(shown[n - 1], n * PERIOD_NS))
            for n in range(len(shown))
        ]
    assert [result.state for result in results] == [SlamState.TRACKING] * len(shown)
    assert [result.is_predicted for result in results[3:]] == [n % 2 == 1 for n in range(3, 60)]
    assert not any(result.is_keyframe for result in results[3::2])
    assert len([text for text in caplog.messages if 'received twice' in text]) == 1
    errors_m = position_errors_m(slam.trajectory.final(), POSES)
    assert len(errors_m) == len(shown)
    assert np.sqrt((errors_m**2).mean()) < 0.02  # the camera moves by 0.05 m between two images


def test_a_copied_pair_has_the_pose_of_the_original() -> None:
    slam, shown = RgbdSlam(CAMERA, SlamConfig()), images()
    before = [slam.process(features) for features in shown[:10]][-1]
    copied = slam.process(copy_of(shown[9], 10 * PERIOD_NS, new_depth=False))
    assert before.T_map_camera is not None
    assert copied.T_map_camera is not None
    np.testing.assert_allclose(copied.T_map_camera, before.T_map_camera, atol=1e-12)
    after = slam.process(replace(shown[10], stamp_ns=11 * PERIOD_NS))
    assert after.state is SlamState.TRACKING
    assert after.num_inliers > 100


def test_a_copy_is_searched_in_the_map_after_a_pose_was_given() -> None:
    slam, shown = RgbdSlam(CAMERA, SlamConfig()), images()
    for features in shown[:10]:
        slam.process(features)
    slam.relocalize_near(PoseHint(np.eye(4), 0.5, 0.5))
    result = slam.process(copy_of(shown[9], 10 * PERIOD_NS))
    assert result.state is SlamState.TRACKING
    assert not result.is_predicted
    assert slam.stats.num_relocalizations == 1
