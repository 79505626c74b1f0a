"""A killed SLAM node resumes its map; one that ended cleanly starts a new map."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hoid_msgs.msg import SlamStatus
from std_srvs.srv import Trigger

from hoid_bringup.live.supervisor import Supervisor
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.running_camera import RunningCamera
from hoid_system_tests.slam_peer import NO_SCENE, START_NS

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

_BACK_S = 5.0  # from the kill to odometry in the same map


@pytest.fixture
def run(start: Start, folder: Path) -> Callable[[], Supervisor]:
    params = {'map_directory': str(folder), 'checkpoint_period_s': 1.0} | NO_SCENE
    return lambda: start('rgbd_slam', 'rgbd_slam_node', params)


def mapped(probe: Probe, folder: Path) -> RunningCamera:
    """Map 20 places with the node that runs; return the camera once there is a checkpoint."""
    peer = RunningCamera(probe)
    peer.await_ready()
    for place in range(20):
        peer.send(place)
    peer.await_checkpoint(folder)
    return peer


def kill(node: Supervisor) -> None:
    for pid in node.pids.values():
        os.kill(pid, signal.SIGKILL)


def test_a_killed_node_resumes_its_map(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    started_s = time.monotonic()
    node = run()
    peer = RunningCamera(probe)
    peer.await_ready()
    clean_s = time.monotonic() - started_s
    for place in range(60):
        assert peer.send(place).state == SlamStatus.TRACKING
    keyframes = peer.status[-1].keyframes
    assert keyframes > 2
    peer.await_checkpoint(folder)
    for place in range(59, 20, -1):
        peer.send(place)
    times_s = []
    for place in (20, 45, 30):
        kill(node)
        killed_s = time.monotonic()
        node = run()
        peer.await_ready()
        assert 'relocalizing the camera' in peer.status[0].message
        assert peer.status[0].mode == SlamStatus.LOCALIZATION
        peer.stamp_ns += round(1e9 * (time.monotonic() - killed_s))
        status = peer.send(place)
        times_s.append(time.monotonic() - killed_s)
        assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.MAPPING)
        assert 'is found in the map from before' in status.message
        assert status.maps == 1
        assert status.keyframes >= 2
        peer.check_pose(place)
    # A busy machine makes every start slow.
    assert sorted(times_s)[1] < max(_BACK_S, 1.5 * clean_s)
    for place in range(30, 110):  # and mapping continues
        assert peer.send(place).state == SlamStatus.TRACKING
    peer.probe.spin_until(
        lambda: peer.send(109).keyframes > keyframes, 'mapping does not continue', 30.0
    )
    peer.check_pose(109)


def test_a_damaged_map_file_does_not_keep_a_checkpoint_from_being_resumed(
    start: Start, probe: Probe, folder: Path
) -> None:
    params = {'map_directory': str(folder), 'checkpoint_period_s': 1.0} | NO_SCENE
    node = start('rgbd_slam', 'rgbd_slam_node', params)
    peer = mapped(probe, folder)
    kill(node)
    (folder / 'damaged.hoidmap').write_bytes(b'half a map')
    start('rgbd_slam', 'rgbd_slam_node', params | {'map_file': 'damaged'})
    peer.await_ready()
    assert 'relocalizing the camera' in peer.status[0].message
    status = peer.send(10)
    assert status.state == SlamStatus.TRACKING
    assert 'is found in the map from before' in status.message
    peer.check_pose(10)


def test_a_map_that_was_stopped_or_reset_is_not_resumed(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    assert peer.probe.call(Trigger, 'rgbd_slam/reset', Trigger.Request(), times=3).success
    assert list(folder.iterdir()) == []
    for place in range(20):
        peer.send(place)
    peer.await_checkpoint(folder)
    node.stop()
    assert list(folder.iterdir()) == []
    run()
    peer.await_ready()
    status = peer.send(30)
    assert (status.mode, status.keyframes) == (SlamStatus.MAPPING, 1)
    assert status.message == ''


def test_a_restarted_recording_gets_a_new_map(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    kill(node)
    peer.stamp_ns = START_NS
    run()
    peer.await_ready()
    status = peer.send(0)
    assert (status.mode, status.keyframes) == (SlamStatus.MAPPING, 1)
