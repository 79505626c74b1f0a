"""What the recorder of a trajectory gives back, and what it keeps for it."""

from __future__ import annotations

import tracemalloc

import numpy as np

from hoid_common import se3
from rgbd_slam.model.keyframes import KeyframeTable
from rgbd_slam.model.trajectory import TrajectoryRecorder

MANY = 5000


def recorded(count: int) -> TrajectoryRecorder:
    """Return a recorder of frames that each move by 1 mm, hung on no keyframe that is there."""
    recorder, T = TrajectoryRecorder(), np.eye(4)
    for n in range(count):
        T = T.copy()
        T[0, 3] = 0.001 * n
        recorder.add(10**9 + n, T, n // 10, T)
    return recorder


def test_poses_come_back_to_the_bit() -> None:
    poses = se3.exp(np.random.default_rng(0).normal(size=(MANY, 6)))
    recorder = TrajectoryRecorder()
    for n, pose in enumerate(poses):
        recorder.add(n, pose, 0, pose)
    online = recorder.online()
    assert len(recorder) == MANY
    np.testing.assert_array_equal(online.stamps_ns, np.arange(MANY))
    np.testing.assert_array_equal(online.T_world_camera, poses)


def test_nothing_recorded_is_an_empty_trajectory() -> None:
    assert len(TrajectoryRecorder().online()) == 0
    assert len(TrajectoryRecorder().final(KeyframeTable())) == 0


def test_a_frame_takes_hardly_more_than_its_numbers() -> None:
    tracemalloc.start()
    recorder = recorded(MANY)
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert len(recorder) == MANY
    assert size < 250 * MANY  # bytes: a stamp, a uid and two poses of 12 numbers are 208
