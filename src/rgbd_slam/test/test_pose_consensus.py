"""Who decides a pose: what moves near the camera or far from it does not, whatever its numbers."""

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
from rgbd_slam.optimize.pose_optimizer import PoseProblem, optimize_pose
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World

NOISE_PX = 0.4
CAMERA = replace(StereoCamera.from_model(MODEL, SlamConfig().camera), pixel_noise=NOISE_PX)
CONSENSUS = PoseConsensus(CAMERA, ConsensusConfig())
TRUTH = se3.exp(np.array([0.02, -0.03, 0.01, 0.02, -0.01, 0.03]))
STEP_M = np.array([0.05, 0.0, 0.0])  # what moves has gone since the map saw it


class Group(NamedTuple):
    """Matched points at like depths."""

    num: int
    depth_m: tuple[float, float]
    is_established: bool
    moves: bool = False
    within_px: tuple[tuple[int, int], tuple[int, int]] = ((20, 20), (620, 460))  # corners


def seen(*groups: Group, step_m: FloatArray = STEP_M) -> tuple[PoseProblem, BoolArray]:
    """Return what an image at `TRUTH` shows of the groups, and which the map has established."""
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
    established = [group.is_established for group in groups]
    is_established = np.repeat(established, [group.num for group in groups])
    return PoseProblem(points_m, measured_px, np.ones(count)), is_established


def error_m(T_camera_map: FloatArray) -> float:
    apart = se3.inverse(T_camera_map)[:3, 3] - se3.inverse(TRUTH)[:3, 3]
    return float(np.linalg.norm(apart))


def moved(groups: tuple[Group, ...]) -> BoolArray:
    return np.repeat([group.moves for group in groups], [group.num for group in groups])


CAPTURES = {
    'near and new to the map': (
        Group(300, (3.5, 5.0), is_established=True),
        Group(350, (0.8, 1.2), is_established=False, moves=True),
    ),
    'near and established': (
        Group(300, (3.5, 5.0), is_established=True),
        Group(100, (0.8, 1.2), is_established=True, moves=True),
    ),
    'near in a map that has established nothing': (
        Group(300, (3.5, 5.0), is_established=False),
        Group(100, (0.8, 1.2), is_established=False, moves=True),
    ),
    'far': (
        Group(170, (1.0, 2.0), is_established=True),
        Group(130, (3.5, 5.0), is_established=True, moves=True),
    ),
}


@pytest.mark.parametrize('groups', CAPTURES.values(), ids=CAPTURES)
def test_what_moves_does_not_capture_the_pose(groups: tuple[Group, ...]) -> None:
    problem, is_established = seen(*groups)
    consensus = CONSENSUS.solve(problem, is_established, np.eye(4))
    assert error_m(consensus.estimate.T_camera_map) < 0.004
    is_mover = moved(groups)
    assert np.mean(consensus.estimate.inliers[is_mover]) < 0.05  # and the map is told so
    assert np.mean(consensus.estimate.inliers[~is_mover]) > 0.95


def test_what_has_just_begun_to_move_does_not_drag_the_pose() -> None:
    """By so little that it fits the pose of all; things that rest are as near."""
    corner_px = (60, 300), (220, 460)
    groups = (
        Group(350, (1.3, 4.5), is_established=True),
        Group(40, (1.1, 1.3), is_established=True, moves=True, within_px=corner_px),
        Group(40, (1.1, 1.3), is_established=False, moves=True, within_px=corner_px),
    )
    problem, is_established = seen(*groups, step_m=np.array([0.008, 0.0, 0.0]))
    dragged = CONSENSUS.solve(problem, is_established, np.eye(4), is_first=True)
    consensus = CONSENSUS.solve(problem, is_established, np.eye(4))
    assert error_m(dragged.estimate.T_camera_map) > 0.005
    assert error_m(consensus.estimate.T_camera_map) < 0.001
    off = PoseConsensus(CAMERA, ConsensusConfig(leave_out_parts=False))
    with_parts = off.solve(problem, is_established, np.eye(4))
    np.testing.assert_array_equal(with_parts.estimate.T_camera_map, dragged.estimate.T_camera_map)
    assert consensus.dragging is not None
    camera_m = se3.transform(TRUTH, problem.points_m)
    inside = consensus.dragging.region.holds(
        CAMERA, problem.measured_px.astype(np.float32), camera_m[:, 2].astype(np.float32)
    )
    assert np.mean(inside[moved(groups)]) > 0.9
    assert np.mean(inside[~moved(groups)]) < 0.1


def test_without_a_consensus_near_movers_take_the_pose_with_them() -> None:
    """What these scenes would prove nothing without."""
    off = PoseConsensus(CAMERA, ConsensusConfig(enabled=False))
    for groups in ('near and new to the map', 'near and established'):
        problem, is_established = seen(*CAPTURES[groups])
        consensus = off.solve(problem, is_established, np.eye(4))
        assert error_m(consensus.estimate.T_camera_map) > 0.02
        assert consensus.rival is None


def test_where_nothing_moves_all_matches_have_their_say() -> None:
    problem, is_established = seen(
        Group(200, (1.0, 5.0), is_established=True), Group(200, (1.0, 5.0), is_established=False)
    )
    consensus = CONSENSUS.solve(problem, is_established, np.eye(4))
    usual = optimize_pose(CAMERA, problem, np.eye(4))
    np.testing.assert_array_equal(consensus.estimate.T_camera_map, usual.T_camera_map)
    np.testing.assert_array_equal(consensus.estimate.information, usual.information)
    assert consensus.rival is None
    assert consensus.dragging is None


def test_the_other_motion_is_named_with_its_share() -> None:
    groups = CAPTURES['near and established']
    problem, is_established = seen(*groups)
    rival = CONSENSUS.solve(problem, is_established, np.eye(4)).rival
    assert rival is not None
    assert 0.55 < rival.chosen_share < 0.8  # three of four rest
    assert 0.2 < rival.rival_share < 0.45
    assert np.linalg.norm(rival.twist[3:]) > 0.02


def test_the_covariance_reaches_to_the_other_motion() -> None:
    problem, is_established = seen(*CAPTURES['near and established'])
    consensus = CONSENSUS.solve(problem, is_established, np.eye(4))
    assert consensus.rival is not None
    twist = consensus.rival.twist
    away_m = np.linalg.norm(twist[3:])
    sigma_m = np.sqrt(twist[3:] @ consensus.covariance[3:, 3:] @ twist[3:]) / away_m
    assert away_m / 3 < sigma_m < away_m
    alone = consensus._replace(rival=None)
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
    """Half of what a camera sees moves before the map has established anything."""
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


def test_few_matches_are_solved_as_ever() -> None:
    problem, is_established = seen(Group(12, (1.0, 5.0), is_established=True))
    consensus = CONSENSUS.solve(problem, is_established, np.eye(4))
    assert error_m(consensus.estimate.T_camera_map) < 0.02
    nothing = problem.select(np.zeros(12, np.bool_))
    none = CONSENSUS.solve(nothing, np.zeros(0, np.bool_), TRUTH)
    np.testing.assert_array_equal(none.estimate.T_camera_map, TRUTH)
