"""Published covariances match the errors: squared errors, normalized, are about 1 on average."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.robot_frames import RobotFrames, RobotPose
from rgbd_slam.session import SlamSession

from .world import CAMERA, PERIOD_NS, World, sway

FRAMES = 90
SECOND = 30  # frames
YOUNG = 5  # frames until the noise is measured


@pytest.fixture(scope='module')
def truth() -> FloatArray:
    return sway(FRAMES, turn_rad=0.3, way_m=0.4)


@pytest.fixture(scope='module')
def poses(truth: FloatArray) -> list[RobotPose]:
    """Return the poses that a session estimates from pixels half as noisy as configured."""
    session, world = SlamSession(CAMERA, SlamConfig(), RobotFrames()), World()
    found = [
        session.process(world.features(n * PERIOD_NS, T, noise_px=0.5)).pose
        for n, T in enumerate(truth)
    ]
    return [pose for pose in found if pose is not None]


def normalized(error: FloatArray, covariance: FloatArray) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def test_relative_poses_over_a_second(truth: FloatArray, poses: list[RobotPose]) -> None:
    assert len(poses) == FRAMES
    squares = []
    for a in range(YOUNG, FRAMES - SECOND):
        b = a + SECOND
        true = se3.inverse(truth[a]) @ truth[b]
        found = se3.inverse(poses[a].T_odom_base) @ poses[b].T_odom_base
        A = se3.adjoint(se3.inverse(true))
        covariance = poses[b].covariance + A @ poses[a].covariance @ A.T
        squares.append(normalized(se3.log(se3.inverse(true) @ found), covariance))
    assert 0.4 < np.mean(squares) < 2


def test_twists(truth: FloatArray, poses: list[RobotPose]) -> None:
    squares = []
    for n in range(YOUNG, FRAMES):
        true = se3.log(se3.inverse(truth[n - 1]) @ truth[n]) / (1e-9 * PERIOD_NS)
        squares.append(normalized(poses[n].twist - true, poses[n].twist_covariance))
    assert 0.5 < np.mean(squares) < 2
