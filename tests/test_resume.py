"""A killed SLAM node resumes its map; one that ended cleanly keeps it and starts a new one."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hoid_msgs.msg import SlamStatus
from std_srvs.srv import Trigger

from hoid_bringup.live.supervisor import Supervisor
from hoid_common.ros import conversions
from hoid_common.values import NS_PER_S
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, executable
from hoid_system_tests.running_camera import RunningCamera
from hoid_system_tests.slam_peer import START_NS
from rgbd_slam.store import map_file

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

_BACK_S = 5.0  # from the kill to odometry in the same map


@pytest.fixture
def run(start: Start, folder: Path) -> Callable[[], Supervisor]:
    params = {'map_directory': str(folder), 'checkpoint_period_s': 1.0}
    return lambda: start('rgbd_slam', 'rgbd_slam_node', params)


def mapped(probe: Probe, folder: Path) -> RunningCamera:
    """Map 20 places with the node that runs; return the camera once there is a checkpoint."""
    peer = RunningCamera(probe)
    peer.await_ready()
    peer.send_all(range(20))
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
    peer.send_all(range(59, 20, -1))
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
    params = {'map_directory': str(folder), 'checkpoint_period_s': 1.0}
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


def test_a_map_that_was_stopped_or_reset_is_kept_and_not_resumed(
    run: Callable[[], Supervisor], probe: Probe, folder: Path, tmp_path: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    peer.send_all(range(20, 50))  # of which no checkpoint may know yet
    before = peer.status[-1].keyframes
    assert peer.probe.call(Trigger, 'rgbd_slam/reset', Trigger.Request(), times=3).success
    (kept,) = kept_maps(folder)
    assert len(map_file.load(kept).map) == before
    assert f'map of {before} keyframes kept as {kept}; load it' in log_of(tmp_path)
    for _ in range(10):
        peer.send(100)
    node.stop()
    (_, second) = kept_maps(folder)
    assert len(map_file.load(second).map) == 1
    assert f'map of 1 keyframe kept as {second}; load it' in log_of(tmp_path)
    node = run()
    peer.await_ready()
    status = peer.send(30)
    assert (status.mode, status.keyframes) == (SlamStatus.MAPPING, 1)
    assert status.message == ''
    assert peer.load(kept.stem).success  # which keeps the running map of one keyframe, too
    assert peer.send(30).keyframes == before
    peer.check_pose(30)
    assert len(kept_maps(folder)) == 3


def test_another_camera_keeps_the_map_of_the_one_before(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    run()
    peer = mapped(probe, folder)
    before = peer.status[-1].keyframes
    header = conversions.header_to_msg(peer.stamp_ns, OPTICAL)
    other = conversions.camera_to_msg(replace(CAMERA, fx_px=CAMERA.fx_px + 20.0), header)

    def is_kept() -> bool:
        peer.send_camera(other)
        probe.spin_for(0.1)
        return bool(kept_maps(folder))

    probe.spin_until(is_kept, 'the map is not kept', 30.0)
    (kept,) = kept_maps(folder)
    assert len(map_file.load(kept).map) == before


def test_a_restarted_recording_gets_a_new_map_and_the_old_one_is_kept(
    run: Callable[[], Supervisor], probe: Probe, folder: Path, tmp_path: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    kill(node)
    peer.stamp_ns = START_NS
    run()
    peer.await_ready()
    status = peer.send(0)
    assert (status.mode, status.keyframes) == (SlamStatus.MAPPING, 1)
    (kept,) = kept_maps(folder)
    assert f'keyframes kept as {kept}; load it' in log_of(tmp_path)


def test_a_node_that_was_away_for_a_day_finds_the_camera_in_its_map(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    before = peer.status[-1].keyframes
    kill(node)
    peer.stamp_ns += 24 * 3600 * NS_PER_S
    node = run()
    peer.await_ready()
    assert 'relocalizing the camera' in peer.status[0].message
    status = peer.send(10)
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.MAPPING)
    peer.check_pose(10)
    peer.send_all(range(10, 40))
    peer.await_checkpoint(folder)
    kill(node)
    assert kept_maps(folder) == []  # the map goes on, and nothing of it is lost
    (running,) = folder.glob('.running-*.hoidmap')
    assert len(map_file.load(running).map) >= before


def test_a_map_in_which_the_camera_is_not_found_is_kept(
    run: Callable[[], Supervisor], probe: Probe, folder: Path, tmp_path: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    kill(node)
    (running,) = folder.glob('.running-*.hoidmap')
    before = map_file.load(running).map.digest()
    peer.stamp_ns += 24 * 3600 * NS_PER_S
    peer.world = PointWorld(3000, seed=2)  # the robot was carried to another place
    run()
    peer.await_ready()
    peer.send(0)
    peer.stamp_ns += 31 * NS_PER_S
    assert 'a new map is started beside it' in peer.send(0).message
    peer.send_all(range(20))
    probe.spin_until(lambda: bool(kept_maps(folder)), 'the map is not kept', 30.0)
    (kept,) = kept_maps(folder)
    assert map_file.load(kept).map.digest() == before
    line = f'keyframes kept as {kept}; load it'
    probe.spin_until(lambda: line in log_of(tmp_path), 'no line', 10.0)


def test_a_second_node_says_who_runs_and_takes_no_map(
    run: Callable[[], Supervisor], probe: Probe, folder: Path
) -> None:
    node = run()
    peer = mapped(probe, folder)
    before = peer.status[-1].keyframes
    program = str(executable('rgbd_slam', 'rgbd_slam_node'))
    options = ('-p', f'map_directory:={folder}')
    done = subprocess.run(
        [program, '--ros-args', *options], capture_output=True, text=True, timeout=60, check=False
    )
    (pid,) = node.pids.values()
    assert done.returncode == 1
    assert done.stderr == (
        f'error: another /rgbd_slam runs already: process {pid} on {socket.gethostname()}; it '
        f'stores its map in {folder}. End it, or give this node another namespace, ROS_DOMAIN_ID '
        'or map_directory\n'
    )
    kill(node)
    run()
    peer.await_ready()
    assert peer.send(10).keyframes == before
    assert kept_maps(folder) == []


def test_a_map_that_is_not_kept_is_said(
    start: Start, probe: Probe, folder: Path, tmp_path: Path
) -> None:
    params = {'map_directory': str(folder), 'checkpoint_period_s': 0.0}
    node = start('rgbd_slam', 'rgbd_slam_node', params)
    peer = RunningCamera(probe)
    peer.await_ready()
    peer.send_all(range(30))
    node.stop()
    assert re.search(r'map of [1-9]\d* keyframes is not kept, because', log_of(tmp_path))
    assert list(folder.iterdir()) == []


def test_two_nodes_of_one_name_say_so(
    start: Start, probe: Probe, folder: Path, tmp_path: Path
) -> None:
    for name in ('one', 'other'):
        start('rgbd_slam', 'rgbd_slam_node', {'map_directory': str(folder / name)})
    line = 'another node named /rgbd_slam runs in ROS domain '
    logs = [tmp_path / f'log_{n}' / 'rgbd_slam_node.log' for n in range(2)]
    probe.spin_until(
        lambda: all(log.read_text().count(line) == 1 for log in logs), 'no line', 60.0
    )


def kept_maps(folder: Path) -> list[Path]:
    """Return the kept maps, the oldest first."""
    return sorted(folder.glob('kept-*.hoidmap'), key=lambda path: (len(path.name), path.name))


def log_of(tmp_path: Path) -> str:
    return ''.join(path.read_text() for path in tmp_path.glob('log_*/*.log'))
