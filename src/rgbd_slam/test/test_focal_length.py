"""A wrong focal length is noticed by pairs of keyframes, in both directions, and reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession

from .world import CAMERA, PERIOD_NS, World

TIME = np.linspace(0, 1, 250)
WAY = se3.exp(np.outer(TIME, [0, 4 * np.pi, 0, 0, 0, 0])) @ se3.exp(
    np.outer(TIME, [0, 0, 0, 0.5, -0.6, -1.2])
)


def carried(stated: float) -> SlamSession:
    """Return a session that was told `stated` times the focal length of the images."""
    told = replace(CAMERA, fx_px=stated * CAMERA.fx_px, fy_px=stated * CAMERA.fy_px)
    world, session = World(), SlamSession(told, SlamConfig(), RobotFrames())
    for n, pose in enumerate(WAY):
        session.process(world.features(n * PERIOD_NS, pose))
    return session


@pytest.mark.parametrize(
    ('stated', 'reported'), [(0.92, ' % too short ('), (1.08, '8 % too long (')]
)
def test_a_wrong_focal_length_is_reported(stated: float, reported: str) -> None:
    found = carried(stated).focal_length
    assert 1 + found.error[0] == pytest.approx(1 / stated, abs=0.015)
    assert reported in found.problem


def test_a_right_focal_length_is_not_doubted() -> None:
    found = carried(1.0).focal_length
    assert found.error[0] == pytest.approx(0, abs=0.003)
    assert found.error[1] < 0.003
    assert found.problem == ''


def test_few_keyframes_tell_nothing() -> None:
    found = SlamSession(CAMERA, SlamConfig(), RobotFrames()).focal_length
    assert found.error == (0.0, np.inf)
    assert found.problem == ''
