"""Wheel odometry predicts the motion, and bridges images in which nothing is seen."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import S_PER_NS, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.motion_sources import ExternalOdometry, MotionLookup
from rgbd_slam.tracking.tracking_result import TrackingResult

from .world import CAMERA, PERIOD_NS, World

SEEN, COVERED = 30, 12
FRAMES = SEEN + COVERED + 8
SLIP = np.array([0.0, 0.3, 0, 0.6, 0, 0.2])  # rad/s, m/s


@pytest.fixture(scope='module')
def truth() -> FloatArray:
    """Return poses of a camera that moves by 1 m/s and rotates by 0.5 rad/s."""
    twist = np.zeros((FRAMES, 6))
    twist[:, 1] = 0.5 * PERIOD_NS * S_PER_NS * np.arange(FRAMES)
    twist[:, 3] = 1.0 * PERIOD_NS * S_PER_NS * np.arange(FRAMES)
    return se3.exp(twist)


def wheels(truth: FloatArray, slip: FloatArray | None = None) -> MotionLookup:
    """Return wheel odometry that is exact, or slips with a velocity (6,)."""

    def motion(first_ns: int, second_ns: int) -> FloatArray:
        T = se3.inverse(truth[first_ns // PERIOD_NS]) @ truth[second_ns // PERIOD_NS]
        slipped_s = S_PER_NS * (second_ns - first_ns)
        return T if slip is None else np.asarray(T @ se3.exp(slipped_s * slip))

    return motion


def run(
    truth: FloatArray, lookup: MotionLookup | None, covered: int = COVERED
) -> tuple[RgbdSlam, list[TrackingResult]]:
    """Track images of which some have no features."""
    sources = [] if lookup is None else [ExternalOdometry(lookup)]
    slam, world = RgbdSlam(CAMERA, SlamConfig(), motion_sources=sources), World()
    results = []
    for n, T in enumerate(truth):
        features = world.features(n * PERIOD_NS, T)
        if SEEN <= n < SEEN + covered:
            features = features.select(np.arange(0))
        results.append(slam.process(features))
    return slam, results


def poses(results: list[TrackingResult]) -> FloatArray:
    return np.array([result.T_map_camera for result in results])


def test_slipping_wheels_do_not_change_tracked_poses(truth: FloatArray) -> None:
    _, alone = run(truth, None, covered=0)
    _, slipping = run(truth, wheels(truth, 3 * SLIP), covered=0)
    np.testing.assert_array_equal(poses(slipping), poses(alone))


def test_a_covered_lens_is_bridged(truth: FloatArray) -> None:
    slam, results = run(truth, wheels(truth))
    bridged = results[SEEN : SEEN + COVERED]
    assert {result.state for result in bridged} == {SlamState.LOST}
    np.testing.assert_allclose(poses(bridged), truth[SEEN : SEEN + COVERED], atol=0.02)
    assert bridged[-1].note == (
        'too few map points are seen; the pose follows the wheel odometry, for 0.4 s and 0.40 m'
    )
    covariances = np.array([result.covariance for result in bridged])
    sigma_m = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
    assert (np.diff(sigma_m) > 0).all()
    assert sigma_m[-1] < 0.08  # right as they are, a second of noisy images does not prove more
    assert len(slam.trajectory.final()) == FRAMES - COVERED


def test_tracking_resumes_at_the_pose_of_the_wheels(truth: FloatArray) -> None:
    slam, results = run(truth, wheels(truth))
    after = results[SEEN + COVERED :]
    assert {result.state for result in after} == {SlamState.TRACKING}
    np.testing.assert_allclose(poses(after), truth[SEEN + COVERED :], atol=0.02)
    assert slam.stats.num_relocalizations == 0
    assert run(truth, None)[0].stats.num_relocalizations == 1  # without them


def test_odometry_does_not_jump_when_tracking_resumes(truth: FloatArray) -> None:
    _, results = run(truth, wheels(truth, SLIP))
    odom = np.array([result.T_odom_camera for result in results])
    steps = np.linalg.norm(se3.log(se3.inverse(odom[:-1]) @ odom[1:])[:, 3:], axis=1)
    assert steps.max() < 0.07  # 1 m/s, and half of that more while they slip unseen
    np.testing.assert_allclose(poses(results[-1:]), truth[-1:], atol=0.02)  # which the map is not


def test_poses_after_a_bridge_inherit_its_covariance(truth: FloatArray) -> None:
    _, results = run(truth, wheels(truth, SLIP))
    start = results[SEEN - 1].T_odom_camera
    assert start is not None
    for result in results[SEEN + COVERED - 1 :]:
        assert result.T_odom_camera is not None
        assert result.covariance is not None
        true = se3.inverse(truth[SEEN - 1]) @ truth[result.stamp_ns // PERIOD_NS]
        found = se3.inverse(start) @ result.T_odom_camera
        error = se3.log(se3.inverse(true) @ found)
        assert error @ np.linalg.solve(result.covariance, error) / 6 < 4  # two sigma


def test_slip_before_the_loss_increases_the_covariance(truth: FloatArray) -> None:
    _, results = run(truth, wheels(truth, SLIP))
    last = results[SEEN + COVERED - 1]
    assert last.T_map_camera is not None
    assert last.covariance is not None
    error = se3.log(se3.inverse(truth[SEEN + COVERED - 1]) @ last.T_map_camera)
    assert np.linalg.norm(error[3:]) > 0.2
    assert error @ np.linalg.solve(last.covariance, error) / 6 < 4  # two sigma


def test_a_jerk_is_tracked_with_wheels() -> None:
    """The motion exceeds the search windows and the limits of descriptor matching."""
    T = np.repeat(np.eye(4)[None], 14, axis=0)
    T[10:] = se3.exp(np.array([0.0, 0.25, 0, 0.4, 0, 0]))
    for sources, num_relocalizations in (([], 1), ([ExternalOdometry(wheels(T))], 0)):
        slam, world = RgbdSlam(CAMERA, SlamConfig(), motion_sources=sources), World()
        for n in range(14):
            result = slam.process(world.features(n * PERIOD_NS, T[n]))
            assert result.state is SlamState.TRACKING
        assert slam.stats.num_relocalizations == num_relocalizations
        assert result.T_map_camera is not None
        np.testing.assert_allclose(result.T_map_camera, T[-1], atol=0.02)


def test_wheels_without_data_bridge_nothing(truth: FloatArray) -> None:
    said = wheels(truth)
    silent_ns = (SEEN + 3) * PERIOD_NS
    _, results = run(truth, lambda a, b: None if b > silent_ns else said(a, b))
    known = [result.T_map_camera is not None for result in results[SEEN : SEEN + COVERED]]
    assert known == [True] * 4 + [False] * 8
    assert results[-1].state is SlamState.TRACKING
    assert SlamState(results[SEEN].state.value) is SlamState.LOST


def test_the_error_of_the_wheels_is_learned() -> None:
    source = ExternalOdometry(lambda *_: se3.exp(np.array([0.0, 0, 0, 0.02, 0, 0])))
    for n in range(300):
        source.start(n * PERIOD_NS)
        source.advance((n + 1) * PERIOD_NS)
        source.observe(np.eye(4))
    source.start(0)
    source.advance(PERIOD_NS)
    motion = source.bridge()
    assert motion is not None
    sigma = np.sqrt(np.diag(motion.covariance))
    assert sigma[3] == pytest.approx(0.02, rel=0.01)
    assert sigma[[0, 1, 2, 4, 5]].max() < 1e-3
