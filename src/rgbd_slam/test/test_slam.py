"""The whole core estimates a known trajectory in a synthetic room, with either kind of mapper."""

import os
import select
import subprocess
import sys
from dataclasses import replace
from multiprocessing import active_children
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import MessageError
from hoid_common.slam_status import SlamState
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.mapper_process import MapperProcess, MapperStoppedError
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.keyframe_policy import KeyframePolicy

from .world import CAMERA, PERIOD_NS, World, position_errors_m, sway

POSES = sway(90)


def run(slam: RgbdSlam) -> list[SlamState]:
    world = World()
    states = []
    for n, pose in enumerate(POSES):
        states.append(slam.process(world.features(n * PERIOD_NS, pose)).state)
        wait_for_mapper(slam)
    slam.map.finish()
    return states


def wait_for_mapper(slam: RgbdSlam) -> None:
    """Wait for a mapper in a separate process, so that results do not depend on the machine."""
    if isinstance(slam.map.mapper, MapperProcess):
        slam.map.mapper.wait()


@pytest.mark.slow
def test_a_known_trajectory_comes_back_and_repeats() -> None:
    first, second = (RgbdSlam(CAMERA, SlamConfig()) for _ in range(2))
    assert run(first) == run(second) == [SlamState.TRACKING] * len(POSES)
    for kind in ('final', 'online'):
        one, other = (getattr(slam.trajectory, kind)() for slam in (first, second))
        np.testing.assert_array_equal(one.T_world_camera, other.T_world_camera)
    errors = position_errors_m(first.trajectory.final(), POSES)
    assert np.sqrt((errors**2).mean()) < 0.004
    assert errors.max() < 0.012
    assert 3 <= first.stats.num_keyframes < 40


@pytest.mark.parametrize('keep_outliers', [False, True])
def test_a_keyframe_includes_outliers_only_if_configured_to(
    keep_outliers: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = SlamConfig().updated(
        {'keyframes.keep_outliers': keep_outliers, 'keyframes.min_gap_s': 0.0}
    )
    world, slam = World(), RgbdSlam(CAMERA, config)
    slam.process(world.features(0, POSES[0]))
    moved = world.features(PERIOD_NS, POSES[0])
    moved.uv_px[::10] += 8  # as features on a moving object
    requests: list[KeyframeRequest] = []
    monkeypatch.setattr(slam.map.mapper, 'insert', requests.append)
    monkeypatch.setattr(KeyframePolicy, 'wants', lambda *_: True)
    slam.process(moved)
    (request,) = requests
    has_point = request.tracked.points != NO_POINT
    assert has_point[::10].mean() > 0.9 if keep_outliers else not has_point[::10].any()
    assert np.delete(has_point, slice(None, None, 10)).mean() > 0.9


def test_features_of_an_unknown_octave_are_refused_and_change_nothing() -> None:
    config = SlamConfig().updated({'camera.num_octaves': 6})
    world, slam = World(), RgbdSlam(CAMERA, config)

    def see(n: int, highest: int) -> SlamState:
        seen = world.features(n * PERIOD_NS, POSES[n])
        octave = np.minimum(seen.octave, highest)
        octave[0] = highest
        return slam.process(replace(seen, octave=octave)).state

    said = r'features\.octave: 6 .* camera\.num_octaves of SLAM, 6: raise it'
    with pytest.raises(MessageError, match=said):
        see(0, highest=6)
    assert see(0, highest=5) is SlamState.TRACKING
    with pytest.raises(MessageError, match=said):
        see(1, highest=6)
    assert see(2, highest=5) is SlamState.TRACKING
    assert len(slam.trajectory.online()) == 2


@pytest.mark.slow
def test_mapping_in_a_process_of_its_own() -> None:
    slam = RgbdSlam(CAMERA, SlamConfig(), background=True)
    assert isinstance(slam.map.mapper, MapperProcess)
    assert set(run(slam)) == {SlamState.TRACKING}
    assert slam.map.mapper.queue_length == 0
    assert slam.stats.num_keyframes >= 3
    errors = position_errors_m(slam.trajectory.final(), POSES)
    assert np.sqrt((errors**2).mean()) < 0.008
    assert active_children()
    slam.map.mapper.close()
    assert not active_children()
    slam.map.mapper.close()
    assert len(slam.trajectory.final()) == len(POSES)


def test_a_dead_mapper_is_reported() -> None:
    slam = RgbdSlam(CAMERA, SlamConfig(), background=True)
    mapper = slam.map.mapper
    assert isinstance(mapper, MapperProcess)
    for process in active_children():
        process.kill()
        process.join()
    mapper.settle()
    with pytest.raises(MapperStoppedError, match=r'ends at its start \(signal 9\)'):
        mapper.wait()
    slam.map.mapper.close()


@pytest.mark.slow
def test_a_mapper_that_cannot_start_is_reported_at_once() -> None:
    camera = StereoCamera.from_model(CAMERA, SlamConfig().camera)
    nothing: Any = None  # no configuration: the process fails on its own
    with pytest.raises(MapperStoppedError, match=r'ends at its start \(exit code 1\)'):
        MapperProcess(camera, Atlas(1.2, 8), nothing)


@pytest.mark.slow
def test_a_mapper_that_starts_too_slowly_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr('rgbd_slam.mapping.mapper_process._START_S', 0.001)
    with pytest.raises(MapperStoppedError, match=r'did not start within 0\.001 s .* too busy'):
        RgbdSlam(CAMERA, SlamConfig(), background=True)


@pytest.mark.slow
def test_a_mapper_that_dies_is_replaced_and_continues_the_map() -> None:
    world, slam = World(), RgbdSlam(CAMERA, SlamConfig(), background=True)
    mapper = slam.map.mapper
    assert isinstance(mapper, MapperProcess)
    half = len(POSES) // 2
    for n, pose in enumerate(POSES[:half]):
        slam.process(world.features(n * PERIOD_NS, pose))
        wait_for_mapper(slam)
    slam.map.finish()
    known = set(slam.map.atlas.keyframes.uid[slam.map.atlas.keyframes.indices()].tolist())
    for process in active_children():
        process.kill()
    mapper.settle()  # a request that the dead process cannot serve
    mapper.wait()
    for n, pose in enumerate(POSES[half:], half):
        assert slam.process(world.features(n * PERIOD_NS, pose)).state is SlamState.TRACKING
        wait_for_mapper(slam)
    slam.map.finish()
    uids = slam.map.atlas.keyframes.uid[slam.map.atlas.keyframes.indices()]
    assert slam.map.mapper.num_restarts == 1
    assert known <= set(uids.tolist())
    assert len(uids) > len(known)
    assert len(slam.trajectory.final()) == len(POSES)
    errors = position_errors_m(slam.trajectory.final(), POSES)
    assert np.sqrt((errors**2).mean()) < 0.008
    slam.map.mapper.close()


@pytest.mark.slow
def test_the_mapper_dies_with_a_killed_tracker() -> None:
    code = (
        'import sys\n'
        'from multiprocessing import active_children\n'
        'from rgbd_slam.config.slam_config import SlamConfig\n'
        'from rgbd_slam.model.frame import StereoCamera\n'
        'from rgbd_slam.model.atlas import Atlas\n'
        'from rgbd_slam.mapping.mapper_process import MapperProcess\n'
        'camera = StereoCamera(500.0, 500.0, 320.0, 240.0, 40.0, 0.3, 0.0, (0.0,) * 4)\n'
        'if __name__ == "__main__":\n'
        '    mapper = MapperProcess(camera, Atlas(1.2, 8), SlamConfig())\n'
        '    print(active_children()[0].pid, flush=True)\n'
        '    sys.stdin.read()\n'
    )
    environment = os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, '-c', code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as tracker:
        assert tracker.stdout is not None
        mapper = os.pidfd_open(int(tracker.stdout.readline()))
        tracker.kill()
        ended, _, _ = select.select([mapper], [], [], 10)
        os.close(mapper)
    assert ended
