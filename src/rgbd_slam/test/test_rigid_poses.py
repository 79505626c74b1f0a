"""Poses stay rigid while keyframes are pending, and others enter no map and no trajectory."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.process.child_process import ChildTimeoutError
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.mapper import KeyframeRequest, Mapper
from rgbd_slam.mapping.mapper_process import MapperProcess
from rgbd_slam.mapping.mapper_worker import MapperReport, Ready, Request
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.map_change import Move
from rgbd_slam.model.points import PointCounts
from rgbd_slam.model.pose_guard import PoseGuard
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.model.trajectory import TrajectoryRecorder
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession

from .world import CAMERA, PERIOD_NS, World, empty_frame, sway

CONFIG = SlamConfig()
STEREO = StereoCamera.from_model(CAMERA, CONFIG.camera)
NONE = np.empty(0, np.int64)
BROKEN = (np.nan, np.inf, 1e200, 1.001)  # factors on a rotation that is none any more


class SilentWorker:
    """A mapping process that takes requests and never answers."""

    num_restarts = 0
    has_report = False

    def __init__(self) -> None:
        self._is_ready = False

    def send(self, message: Request) -> None:
        """Take a request."""

    def receive(self, timeout_s: float) -> Ready | MapperReport:  # noqa: ARG002
        """Report the start, and nothing else."""
        if self._is_ready:
            raise ChildTimeoutError
        self._is_ready = True
        return Ready()

    def restart(self) -> str:
        raise NotImplementedError

    def close(self) -> str:
        return ''


def request(uid: int, tracked: TrackedFrame) -> KeyframeRequest:
    """Return the request to make a frame a keyframe."""
    return KeyframeRequest(
        uid, tracked, PointCounts(NONE, NONE, NONE, NONE), STEREO, NONE, NONE,
    )  # fmt: skip


def rigid_error(T: FloatArray) -> float:
    """Return the largest entry of R R^T - I of poses (..., 4, 4)."""
    R = T[..., :3, :3]
    return float(np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max())


@pytest.fixture(name='atlas')
def fixture_atlas() -> Atlas:
    """Return a map of two keyframes without points."""
    atlas = Atlas(1.2, 8)
    first = atlas.add_keyframe(empty_frame(), np.eye(4), 0)
    atlas.add_keyframe(empty_frame(1), se3.exp(np.full(6, 0.1)), 0, first)
    return atlas


@pytest.mark.parametrize('count', [40, 100])  # more than 64 wait: some of them are removed again
def test_a_chain_of_pending_keyframes_keeps_exact_rigid_poses(count: int) -> None:
    atlas = Atlas(1.2, 8)
    worker: Any = SilentWorker()
    mapper = MapperProcess(STEREO, atlas, CONFIG, worker=worker)
    steps = se3.exp(np.random.default_rng(0).normal(0, 0.2, (count, 6)))
    first = se3.exp(np.linspace(0.3, 1.0, 6))
    truth = [first]
    mapper.start_map(0, empty_frame(), first, 0)
    for uid, step in enumerate(steps, 1):
        truth.append(se3.orthonormalized(truth[-1] @ step))
        last = atlas.pose(uid - 1)
        assert last is not None
        tracked = tracked_frame(empty_frame(uid), last @ step, NONE, atlas, uid - 1)
        mapper.insert(request(uid, tracked))

    poses = [atlas.pose(uid) for uid in range(count + 1)]
    assert all(pose is not None for pose in poses)
    assert rigid_error(np.array(poses)) < 1e-13
    np.testing.assert_allclose(np.array(poses), truth, atol=1e-12)


@pytest.mark.parametrize('factor', BROKEN)
def test_only_finite_rotations_and_translations_are_rigid(factor: float) -> None:
    T = se3.exp(np.random.default_rng(0).normal(size=(5, 6)))
    assert se3.is_rigid(T).all()
    assert se3.is_rigid(T[0])
    T[1, :3, :3] *= factor
    T[2, 0, 3] = np.nan
    T[3, :3, 0] *= -1  # a reflection
    T[4, 3] = (0, 0, 1e-9, 1)
    assert se3.is_rigid(T).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize('factor', BROKEN)
def test_no_invalid_pose_enters_the_map(factor: float, atlas: Atlas) -> None:
    rows, before = atlas.keyframes.indices(), atlas.keyframes.T_map_camera.copy()
    moved = se3.exp(np.array([0, 0, 0, 1.0, 0, 0])) @ before[rows]
    moved[1, :3, :3] *= factor

    atlas.set_poses(rows, moved)
    np.testing.assert_array_equal(atlas.keyframes.T_map_camera[rows], [moved[0], before[rows[1]]])
    move = atlas.move(rows, moved)
    assert isinstance(move, Move)
    assert move.uids.tolist() == [atlas.keyframes.uid[rows[0]]]
    np.testing.assert_array_equal(atlas.keyframes.T_map_camera[rows[1]], before[rows[1]])
    assert atlas.guard.num_refused == 2


@pytest.mark.parametrize('factor', BROKEN)
def test_no_keyframe_with_an_invalid_pose_is_inserted(factor: float) -> None:
    atlas = Atlas(1.2, 8)
    mapper = Mapper(STEREO, atlas, CONFIG)
    first = mapper.start_map(0, empty_frame(), np.eye(4), 0)
    tracked = TrackedFrame(empty_frame(1), np.eye(4), NONE, NONE, 0, np.diag([factor, 1, 1, 1]))
    assert mapper.insert(request(1, tracked)) is None
    assert atlas.keyframes.indices().tolist() == [first]
    assert atlas.guard.num_refused == 1


def test_refused_poses_of_the_mapper_are_counted_in_the_tracker(atlas: Atlas) -> None:
    copy = Atlas(1.2, 8)
    copy.apply(atlas.whole())
    atlas.set_poses(atlas.keyframes.indices(), np.full((2, 4, 4), np.nan))
    copy.apply(atlas.changes_since(0))
    assert copy.guard.num_refused == 2
    copy.apply(atlas.changes_since(atlas.version))
    assert copy.guard.num_refused == 2  # each is counted once


def test_no_trajectory_contains_an_invalid_pose(atlas: Atlas) -> None:
    recorder = TrajectoryRecorder(atlas)
    uid = int(atlas.keyframes.uid[atlas.keyframes.indices()[0]])
    for n, factor in enumerate((1.0, *BROKEN, 1.0)):
        T = np.diag([factor, 1, 1, 1])
        recorder.add(TrackedFrame(empty_frame(n), T, NONE, NONE, uid, T))
    for trajectory in (recorder.online(), recorder.final()):
        assert trajectory.stamps_ns.tolist() == [0, len(BROKEN) + 1]
        np.testing.assert_array_equal(trajectory.T_world_camera, [np.eye(4)] * 2)
    assert atlas.guard.num_refused == 2 * len(BROKEN)


@pytest.mark.parametrize('factor', [np.nan, 1.001])
def test_an_image_with_an_invalid_pose_is_lost_and_its_pose_not_published(
    factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, session = World(), SlamSession(CAMERA, CONFIG, RobotFrames(None))
    poses, valid, is_broken = sway(60), PoseGuard.is_valid, False

    def is_valid(guard: PoseGuard, T: FloatArray, name: str) -> bool:
        return valid(guard, factor * T if is_broken and name == 'images' else T, name)

    monkeypatch.setattr(PoseGuard, 'is_valid', is_valid)
    published = []
    for n in range(30):
        is_broken = 10 <= n < 15
        published.append(session.process(world.features(n * PERIOD_NS, poses[n])).pose is not None)
    assert published == [not 10 <= n < 15 for n in range(30)]
    assert len(session.map.trajectory('online')) == 25
    assert session.map.atlas.guard.num_refused >= 5


def test_refused_poses_are_said_once_in_five_seconds(caplog: pytest.LogCaptureFixture) -> None:
    guard = PoseGuard()
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert not guard.is_valid(np.full((4, 4), np.nan), 'images')
        assert not guard.is_valid(np.full((4, 4), np.nan), 'keyframes')
    assert [record.args for record in caplog.records] == [('images',), ('keyframes',)]
    assert guard.num_refused == 4
