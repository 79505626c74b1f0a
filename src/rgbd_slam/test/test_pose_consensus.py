"""Moving objects do not determine the pose, near or far, however many points they have."""

import re
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.optimize.pose_consensus import PoseConsensus
from rgbd_slam.optimize.pose_optimizer import PosePrior, PoseProblem, optimize_pose
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World

NOISE_PX = 0.4
CAMERA = replace(StereoCamera.from_model(MODEL, SlamConfig().camera), pixel_noise=NOISE_PX)
CONSENSUS = PoseConsensus(CAMERA, ConsensusConfig())
TRUTH = se3.exp(np.array([0.02, -0.03, 0.01, 0.02, -0.01, 0.03]))
STEP_M = np.array([0.05, 0.0, 0.0])  # motion of objects since the map saw them


class Group(NamedTuple):
    """Matched points in a range of depths."""

    num: int
    depth_m: tuple[float, float]
    is_well_observed: bool
    moves: bool = False
    within_px: tuple[tuple[int, int], tuple[int, int]] = ((20, 20), (620, 460))  # corners


def seen(*groups: Group, step_m: FloatArray = STEP_M) -> tuple[PoseProblem, BoolArray]:
    """Return the matches of an image at `TRUTH`, and the mask of well-observed points."""
    rng = np.random.default_rng(0)
    count = sum(group.num for group in groups)
    low, high = np.concatenate([np.tile(group.depth_m, (group.num, 1)) for group in groups]).T
    corners_px = np.concatenate([np.tile(group.within_px, (group.num, 1, 1)) for group in groups])
    uv_px = rng.uniform(corners_px[:, 0], corners_px[:, 1])
    camera_m = CAMERA.back_project(uv_px, rng.uniform(low, high))
    points_m = se3.transform(se3.inverse(TRUTH), camera_m)
    moves = np.repeat([group.moves for group in groups], [group.num for group in groups])
    points_m[moves] -= step_m
    measured_px = CAMERA.project(camera_m) + rng.normal(0, NOISE_PX, (count, 3))
    well_observed = [group.is_well_observed for group in groups]
    is_well_observed = np.repeat(well_observed, [group.num for group in groups])
    return PoseProblem(points_m, measured_px, np.ones(count)), is_well_observed


def error_m(T_camera_map: FloatArray) -> float:
    apart = se3.inverse(T_camera_map)[:3, 3] - se3.inverse(TRUTH)[:3, 3]
    return float(np.linalg.norm(apart))


def moved(groups: tuple[Group, ...]) -> BoolArray:
    return np.repeat([group.moves for group in groups], [group.num for group in groups])


CAPTURES = {
    'near and new to the map': (
        Group(300, (3.5, 5.0), is_well_observed=True),
        Group(350, (0.8, 1.2), is_well_observed=False, moves=True),
    ),
    'near and well observed': (
        Group(300, (3.5, 5.0), is_well_observed=True),
        Group(100, (0.8, 1.2), is_well_observed=True, moves=True),
    ),
    'near in a map without well-observed points': (
        Group(300, (3.5, 5.0), is_well_observed=False),
        Group(100, (0.8, 1.2), is_well_observed=False, moves=True),
    ),
    'far': (
        Group(170, (1.0, 2.0), is_well_observed=True),
        Group(130, (3.5, 5.0), is_well_observed=True, moves=True),
    ),
}


@pytest.mark.parametrize('groups', CAPTURES.values(), ids=CAPTURES)
def test_moving_objects_do_not_capture_the_pose(groups: tuple[Group, ...]) -> None:
    problem, is_well_observed = seen(*groups)
    consensus = CONSENSUS.solve(problem, is_well_observed, np.eye(4))
    assert error_m(consensus.estimate.T_camera_map) < 0.004
    is_mover = moved(groups)
    # Matches on moving objects must not be inliers, because the map uses all inliers.
    assert np.mean(consensus.estimate.inliers[is_mover]) < 0.05
    assert np.mean(consensus.estimate.inliers[~is_mover]) > 0.95


def test_near_and_far_points_disagree_if_the_map_is_bent() -> None:
    problem, is_well_observed = seen(Group(400, (1.0, 5.0), is_well_observed=True))
    depth_m = se3.transform(TRUTH, problem.points_m)[:, 2]
    bent_m = problem.points_m + 0.02 * (depth_m > 3)[:, None] * np.array([1, 0, 0])
    right, bent = (
        CONSENSUS.solve(each, is_well_observed, np.eye(4)).disagreement
        for each in (problem, replace(problem, points_m=bent_m))
    )
    assert right is not None
    assert bent is not None
    assert np.trace(right[3:, 3:]) < 0.005**2
    assert np.trace(bent[3:, 3:]) == pytest.approx(0.02**2, rel=0.3)


def test_an_object_that_begins_to_move_does_not_bias_the_pose() -> None:
    """The object moves so little that it fits the pose of all matches."""
    corner_px = (60, 300), (220, 460)
    groups = (
        Group(350, (1.3, 4.5), is_well_observed=True),
        Group(40, (1.1, 1.3), is_well_observed=True, moves=True, within_px=corner_px),
        Group(40, (1.1, 1.3), is_well_observed=False, moves=True, within_px=corner_px),
    )
    problem, is_well_observed = seen(*groups, step_m=np.array([0.008, 0.0, 0.0]))
    biased = CONSENSUS.solve(problem, is_well_observed, np.eye(4), is_initial=True)
    consensus = CONSENSUS.solve(problem, is_well_observed, np.eye(4))
    assert error_m(biased.estimate.T_camera_map) > 0.005
    assert error_m(consensus.estimate.T_camera_map) < 0.001
    off = PoseConsensus(CAMERA, ConsensusConfig(leave_out_parts=False))
    with_parts = off.solve(problem, is_well_observed, np.eye(4))
    np.testing.assert_array_equal(with_parts.estimate.T_camera_map, biased.estimate.T_camera_map)
    assert consensus.biasing is not None
    camera_m = se3.transform(TRUTH, problem.points_m)
    inside = consensus.biasing.region.contains(
        CAMERA, problem.measured_px.astype(np.float32), camera_m[:, 2].astype(np.float32)
    )
    assert np.mean(inside[moved(groups)]) > 0.9
    assert np.mean(inside[~moved(groups)]) < 0.1


@pytest.mark.parametrize('seed', range(8))
def test_in_a_blur_no_region_is_left_out(seed: int) -> None:
    """Parts of the image contradict each other, and no region of them is to blame."""
    problem, is_well_observed = seen(Group(150, (1.3, 4.5), is_well_observed=True))
    right, low = (problem.measured_px[:, :2] > (CAMERA.cx_px, CAMERA.cy_px)).astype(int).T
    shift_px = np.random.default_rng(seed).normal(0, 1, (2, 2, 3))
    shift_px[..., 2] = shift_px[..., 0]  # depth is right
    blurred = replace(problem, measured_px=problem.measured_px + shift_px[right, low])
    assert CONSENSUS.solve(blurred, is_well_observed, np.eye(4)).biasing is None


def test_without_the_consensus_near_objects_capture_the_pose() -> None:
    """This shows that the consensus is the reason why the other tests pass."""
    off = PoseConsensus(CAMERA, ConsensusConfig(enabled=False))
    for groups in ('near and new to the map', 'near and well observed'):
        problem, is_well_observed = seen(*CAPTURES[groups])
        consensus = off.solve(problem, is_well_observed, np.eye(4))
        assert error_m(consensus.estimate.T_camera_map) > 0.02
        assert consensus.competing is None


def test_a_prior_of_the_rotation_holds_where_a_few_matches_are_wrong() -> None:
    small = Group(14, (3.0, 5.0), is_well_observed=True, within_px=((250, 180), (390, 300)))
    problem, is_well_observed = seen(small)
    measured_px = problem.measured_px.copy()
    measured_px[:, 0] += np.linspace(-2.0, 2.0, len(problem))
    measured_px[:, 2] = np.nan  # no depth
    blurred = replace(problem, measured_px=measured_px)
    information = np.diag([1 / np.deg2rad(0.1) ** 2] * 3 + [0.0] * 3)
    errors_deg = []
    for prior in (None, PosePrior(TRUTH, information)):
        consensus = PoseConsensus(CAMERA, ConsensusConfig(), prior)
        estimate = consensus.solve(blurred, is_well_observed, TRUTH).estimate
        turn = se3.log(estimate.T_camera_map @ se3.inverse(TRUTH))[:3]
        errors_deg.append(float(np.rad2deg(np.linalg.norm(turn))))
    assert errors_deg[0] > 0.2
    assert errors_deg[1] < 0.1


def test_in_a_static_scene_all_matches_determine_the_pose() -> None:
    problem, is_well_observed = seen(
        Group(200, (1.0, 5.0), is_well_observed=True),
        Group(200, (1.0, 5.0), is_well_observed=False),
    )
    consensus = CONSENSUS.solve(problem, is_well_observed, np.eye(4))
    fit_to_all = optimize_pose(CAMERA, problem, np.eye(4))
    np.testing.assert_array_equal(consensus.estimate.T_camera_map, fit_to_all.T_camera_map)
    np.testing.assert_array_equal(consensus.estimate.information, fit_to_all.information)
    assert consensus.competing is None
    assert consensus.biasing is None


def test_a_competing_motion_is_reported_with_its_share() -> None:
    groups = CAPTURES['near and well observed']
    problem, is_well_observed = seen(*groups)
    competing = CONSENSUS.solve(problem, is_well_observed, np.eye(4)).competing
    assert competing is not None
    assert 0.55 < competing.chosen_ratio < 0.8  # three of four rest
    assert 0.2 < competing.competing_ratio < 0.45
    assert np.linalg.norm(competing.twist[3:]) > 0.02


def test_the_covariance_includes_the_competing_motion() -> None:
    problem, is_well_observed = seen(*CAPTURES['near and well observed'])
    consensus = CONSENSUS.solve(problem, is_well_observed, np.eye(4))
    assert consensus.competing is not None
    twist = consensus.competing.twist
    away_m = np.linalg.norm(twist[3:])
    sigma_m = np.sqrt(twist[3:] @ consensus.covariance[3:, 3:] @ twist[3:]) / away_m
    assert away_m / 3 < sigma_m < away_m
    alone = consensus._replace(competing=None)
    np.testing.assert_allclose(alone.covariance, np.linalg.inv(consensus.estimate.information))


def test_the_status_says_that_two_motions_explain_an_image() -> None:
    world = World()
    world.points_m[::8] *= 0.5  # near the camera
    session = SlamSession(MODEL, SlamConfig(), RobotFrames())
    before = session.process(world.features(0, np.eye(4)))
    world.points_m[::8] += STEP_M / 3
    after = session.process(world.features(PERIOD_NS, np.eye(4)))
    assert before.status.message == ''
    assert re.match(r'two motions explain this image: \d+ % / \d+ %', after.status.message)
    assert after.pose is not None
    assert np.linalg.norm(after.pose.T_odom_base[:3, 3]) < 0.005


def test_a_capture_at_the_start_is_within_three_sigma() -> None:
    """A third of the points moves before any point is well observed."""
    world, slam = World(), RgbdSlam(MODEL, SlamConfig())
    world.points_m[::3] *= 0.5
    slam.process(world.features(0, np.eye(4)))
    world.points_m[::3] += STEP_M / 3
    result = slam.process(world.features(PERIOD_NS, np.eye(4)))
    assert result.T_map_camera is not None
    assert result.covariance is not None
    twist = se3.log(result.T_map_camera)
    assert np.linalg.norm(twist[3:]) > 0.01  # it is captured
    assert twist[3:] @ np.linalg.solve(result.covariance[3:, 3:], twist[3:]) < 3**2


def test_few_matches_give_a_pose() -> None:
    problem, is_well_observed = seen(Group(12, (1.0, 5.0), is_well_observed=True))
    consensus = CONSENSUS.solve(problem, is_well_observed, np.eye(4))
    assert error_m(consensus.estimate.T_camera_map) < 0.02
    nothing = problem.select(np.zeros(12, np.bool_))
    none = CONSENSUS.solve(nothing, np.zeros(0, np.bool_), TRUTH)
    np.testing.assert_array_equal(none.estimate.T_camera_map, TRUTH)
