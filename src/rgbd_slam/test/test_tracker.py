"""Tracking when the prediction fails: a more expensive search recovers the known pose."""

from typing import Any

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig, TrackingConfig
from rgbd_slam.matching.landmarks import landmarks_of_frame, temporal_landmarks
from rgbd_slam.matching.matching import match_by_descriptor
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.optimize.alignment import Alignment, align_image
from rgbd_slam.optimize.pose_optimizer import PoseEstimate, covariance
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.tracker import Tracker

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World, position_errors_m, sway

CONFIG = SlamConfig()
CAMERA = StereoCamera.from_model(MODEL, CONFIG.camera)


class Known:
    """A map of one keyframe at the identity, with a point at each depth reading."""

    def __init__(self, num_points: int | None = None) -> None:
        self.world = World()
        self.map = Atlas(1.2, 8)
        self.tracker = Tracker(CAMERA, self.map, TrackingConfig())
        frame = self.frame(0, np.eye(4))
        i = self.map.add_keyframe(frame, np.eye(4), 0)
        k = np.flatnonzero(frame.has_depth)[:num_points]
        position_m = CAMERA.back_project(frame.measurement_px[k], frame.depth_m[k])
        self.map.add_points(i, k, position_m)
        points = self.map.keyframes.point_of_feature[i, : len(frame)].astype(np.int64)
        self.last: TrackedFrame = tracked_frame(frame, np.eye(4), points, self.map, i)

    def frame(self, n: int, T_world_camera: FloatArray) -> Frame:
        return Frame.from_features(
            self.world.features(n * PERIOD_NS, T_world_camera), MODEL, CAMERA
        )

    def error(self, n: int, twist: list[float]) -> tuple[float, float]:
        """Return the errors [rad, m] of tracking a frame at a pose, with no motion predicted."""
        T_world_camera = se3.exp(np.array(twist))
        tracking = self.tracker.track(self.frame(n, T_world_camera), self.last, np.eye(4))
        assert tracking is not None
        apart = se3.log(se3.inverse(T_world_camera) @ tracking.tracked.T_map_camera)
        return float(np.linalg.norm(apart[:3])), float(np.linalg.norm(apart[3:]))


@pytest.mark.parametrize('turn_rad', [0.02, 0.08, 0.2, -0.3])
def test_an_unpredicted_rotation_is_tracked(turn_rad: float) -> None:
    """The error of the prediction is a third of the search window to ten times the window."""
    error_rad, error_m = Known().error(1, [0, turn_rad, 0.05, 0.05, 0, 0])
    assert error_rad < 0.004
    assert error_m < 0.015


def test_ransac_samples_depend_on_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = se3.exp(np.array([0, 0.3, 0, 0, 0, 0]))  # matched by descriptors, not predicted
    states: list[Any] = []

    def noted(*args: Any) -> Alignment | None:
        states.append(args[-1].bit_generator.state['state'])
        return align_image(*args)

    monkeypatch.setattr('rgbd_slam.tracking.tracker.align_image', noted)
    for seed in (0, 1, 1):
        world, slam = World(), RgbdSlam(MODEL, SlamConfig(seed=seed))
        for n, pose in enumerate((np.eye(4), turned)):
            slam.process(world.features(n * PERIOD_NS, pose))
    first, second, again = states
    assert first != second == again


def test_an_impossible_jump_is_left_to_relocalization() -> None:
    known = Known()
    there = se3.exp(np.array([0, 0, 0, 0.5, 0, 0]))
    assert known.tracker.track(known.frame(1, there), known.last, np.eye(4)) is None
    assert known.tracker.track(known.frame(9, there), known.last, np.eye(4)) is not None
    assert known.tracker.track(known.frame(20, there), known.last, np.eye(4)) is None


def test_depth_readings_of_the_last_frame_help_where_the_map_ends() -> None:
    known = Known(num_points=12)
    assert np.count_nonzero(known.last.points != NO_POINT) == 12
    error_rad, error_m = known.error(1, [0, 0.02, 0, 0.02, 0, 0])
    assert error_rad < 0.003
    assert error_m < 0.01
    tracking = known.tracker.track(known.frame(2, np.eye(4)), known.last, np.eye(4))
    assert tracking is not None
    assert tracking.num_inliers <= tracking.num_matches <= 12  # of the map; the rest is forgotten
    assert np.count_nonzero(tracking.tracked.points != NO_POINT) == tracking.num_inliers


def test_temporal_landmarks_are_the_depth_readings_without_a_point() -> None:
    known = Known(num_points=12)
    read = temporal_landmarks(known.last, known.map, CAMERA)
    seen = landmarks_of_frame(known.last, known.map)
    assert len(seen.point) == 12
    assert len(read.point) == np.count_nonzero(known.last.frame.has_depth) - 12
    assert (read.point == NO_POINT).all()
    pixels = CAMERA.project(read.position_m)
    distance = np.linalg.norm(
        pixels[:, None, :2] - known.last.frame.measurement_px[None, :, :2], axis=2
    )
    assert distance.min(axis=1).max() < 1e-3


def test_descriptors_match_features_anywhere_in_the_image() -> None:
    known = Known()
    frame = known.frame(1, se3.exp(np.array([0, 0, 0.4, 0, 0, 0.0])))
    points = landmarks_of_frame(known.last, known.map)
    matches = match_by_descriptor(points.descriptors, frame, 60, 0.8)
    camera_m = se3.transform(se3.exp(np.array([0, 0, -0.4, 0, 0, 0.0])), points.position_m)
    apart_px = CAMERA.project(camera_m[matches.q])[:, :2] - frame.measurement_px[matches.k, :2]
    assert len(matches.q) > 300
    assert np.median(np.abs(apart_px)) < 1.5
    assert len(np.unique(matches.k)) == len(matches.k)
    none = frame.descriptors[:1]
    assert len(match_by_descriptor(none, frame, 60, 0.8).q) == 0


def test_a_camera_that_is_shaken_is_tracked() -> None:
    """The camera turns by up to 12 degrees per frame in changing, unpredictable directions."""
    poses, world, slam = sway(18, way_m=0.2), World(), RgbdSlam(MODEL, SlamConfig())
    states = [slam.process(world.features(n * PERIOD_NS, T)).state for n, T in enumerate(poses)]
    assert states == [SlamState.TRACKING] * len(poses)
    assert slam.stats.num_relocalizations == 0
    assert position_errors_m(slam.trajectory.final(), poses).max() < 0.03


def test_the_covariance_is_the_inverse_of_the_information() -> None:
    none = np.empty(0, np.bool_)
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 6))
    known = PoseEstimate(np.eye(4), none, half @ half.T + np.eye(6))
    np.testing.assert_allclose(covariance(known) @ known.information, np.eye(6), atol=1e-9)
