"""Map files and modes through real clients: saved, loaded, extended, merged, refused."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import SaveTrajectory
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

from hoid_bringup.live.supervisor import Supervisor
from hoid_common.io.tum_text import read_tum
from hoid_common.ros import conversions
from hoid_system_tests.point_world import CAMERA
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, mapper_of
from hoid_system_tests.running_camera import RunningCamera
from rgbd_slam.store import map_file

pytestmark = pytest.mark.thorough


Begin = Callable[..., tuple[RunningCamera, Supervisor]]


@pytest.fixture
def begin(start: Start, probe: Probe, folder: Path) -> Begin:
    """Start a node and return a camera for it."""

    def begin(**params: Any) -> tuple[RunningCamera, Supervisor]:
        probe.spin_until(
            lambda: probe.node.count_subscribers('features') == 0,
            'the previous node does not leave the graph',
            30.0,
        )
        given = {'map_directory': str(folder)} | params
        supervisor = start('rgbd_slam', 'rgbd_slam_node', given)
        peer = RunningCamera(probe)
        peer.begin()
        return peer, supervisor

    return begin


def test_a_saved_map_is_used_and_extended_by_a_later_node(begin: Begin, folder: Path) -> None:
    peer, supervisor = begin()
    peer.send_all(range(40))
    answer = peer.save()
    assert answer.success, answer.message
    assert str(folder / 'map.hoidmap') in answer.message
    saved = map_file.load(folder / 'map.hoidmap')
    assert saved.camera == CAMERA
    assert f'{len(saved.map)} keyframes' in answer.message
    supervisor.stop()

    peer, _ = begin()
    answer = peer.load()
    assert answer.success, answer.message
    answer = peer.set_mode('localization')
    assert answer.success, answer.message
    status = peer.send(30)  # not where the first session started
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.LOCALIZATION)
    assert status.keyframes == len(saved.map)
    peer.check_pose(30)
    statuses = peer.send_all((*range(29, 5, -1), *range(30, 45)))
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    peer.check_pose(44)
    assert peer.save('again').success
    assert map_file.load(folder / 'again.hoidmap').map.digest() == saved.map.digest()

    answer = peer.set_mode('mapping')
    assert answer.success, answer.message
    statuses = peer.send_all(range(45, 100))
    assert {status.mode for status in statuses} == {SlamStatus.MAPPING}
    peer.probe.spin_until(
        lambda: peer.send(99).keyframes > len(saved.map), 'mapping does not continue', 30.0
    )
    peer.check_pose(99)
    assert peer.save('more').success
    more = map_file.load(folder / 'more.hoidmap').map
    assert len(more) > len(saved.map)
    assert (more.map_id == 0).all()


def test_a_second_session_is_merged_with_a_loaded_map(begin: Begin, folder: Path) -> None:
    peer, supervisor = begin()
    peer.send_all(range(70))
    assert peer.save('first').success
    supervisor.stop()

    peer, _ = begin()
    odometry = peer.probe.collect(Odometry, 'odom')
    peer.send_all(range(150, 110, -1))  # a new map in a frame of its own
    answer = peer.load('first', merge=True)
    assert answer.success, answer.message
    status = peer.send(110)
    assert (status.state, status.maps) == (SlamStatus.TRACKING, 2)
    statuses = peer.send_all(range(109, 10, -1))
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    peer.probe.spin_until(lambda: peer.send(10).maps == 1, 'the maps are not merged', 30.0)
    peer.check_pose(10)
    assert peer.status[-1].merges == 1
    odom = np.array([conversions.pose_from_msg(msg.pose.pose) for msg in odometry])
    steps = np.linalg.norm(np.diff(odom[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.03
    assert peer.save('both').success
    both = map_file.load(folder / 'both.hoidmap').map
    assert (both.map_id == 0).all()


def test_a_map_is_loaded_at_the_start(begin: Begin) -> None:
    peer, supervisor = begin()
    peer.send_all(range(20))
    assert peer.save('home').success
    supervisor.stop()
    peer, _ = begin(map_file='home', mode='localization')
    status = peer.send(12)
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.LOCALIZATION)
    peer.check_pose(12)


def test_reset_discards_a_loaded_map(begin: Begin) -> None:
    peer, _ = begin()
    peer.send_all(range(20))
    assert peer.save().success
    assert peer.set_mode('localization').success
    assert peer.load().success
    client = peer.probe.node.create_client(Trigger, 'rgbd_slam/reset')
    peer.probe.spin_until(client.service_is_ready, 'no reset')
    answer = client.call_async(Trigger.Request())
    peer.probe.spin_until(answer.done, 'no reset', 60.0)  # it starts a process
    assert answer.result().success
    status = peer.send(3)
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.MAPPING)
    assert status.keyframes == 1


def tampered(path: Path) -> bytes:
    """Return a copy of a map file with one byte of a descriptor inverted."""
    with closing(sqlite3.connect(path)) as connection:
        ((features,),) = connection.execute('SELECT features FROM features LIMIT 1').fetchall()
    out = bytearray(path.read_bytes())
    out[out.index(features[-1000:-900])] ^= 0xFF
    return bytes(out)


def test_faulty_files_leave_the_running_map_unchanged(begin: Begin, folder: Path) -> None:
    peer, _ = begin()
    for answer in (peer.save(), peer.set_mode('localization')):
        assert not answer.success
    assert 'nothing has been mapped yet' in peer.save().message
    assert 'no map to localize in' in peer.set_mode('localization').message
    peer.send_all(range(10))
    assert peer.set_mode('localization').success
    assert peer.save('good').success
    good = (folder / 'good.hoidmap').read_bytes()
    digest = map_file.load(folder / 'good.hoidmap').map.digest()
    (folder / 'cut.hoidmap').write_bytes(good[: len(good) // 2])
    (folder / 'flipped.hoidmap').write_bytes(tampered(folder / 'good.hoidmap'))
    (folder / 'foreign.hoidmap').write_bytes(b'P5 1 1 255 a')
    (folder / 'folder.hoidmap').mkdir()
    os.mkfifo(folder / 'pipe.hoidmap')
    (folder / 'link.hoidmap').symlink_to('/etc/passwd')
    octaves = map_file.load(folder / 'good.hoidmap')._replace(num_octaves=4)
    map_file.save(folder / 'octaves.hoidmap', octaves)
    for name, message in (
        ('none', 'no such file'),
        ('cut', 'damaged'),
        ('flipped', 'damaged'),
        ('foreign', 'no map file'),
        ('folder', 'not a regular file'),
        ('pipe', 'not a regular file'),
        ('link', 'is a link'),
        ('octaves', 'camera.num_octaves'),
        ('../good', 'no plain file name'),
        ('/etc/passwd', 'no plain file name'),
        ('..', 'no plain file name'),
    ):
        for merge in (False, True):
            answer = peer.load(name, merge=merge)
            assert not answer.success, name
            assert message in answer.message, (name, answer.message)
            assert '\n' not in answer.message
    assert not peer.save('../outside').success
    assert not peer.save('link').success
    assert not peer.set_mode('dreaming').success
    assert peer.send(10).state == SlamStatus.TRACKING
    assert peer.save('after').success
    assert map_file.load(folder / 'after.hoidmap').map.digest() == digest


@pytest.mark.parametrize('what', ['map', 'keyframes'])
def test_a_file_is_saved_once_the_mapper_has_inserted_the_first_keyframe(
    begin: Begin, folder: Path, what: str
) -> None:
    peer, node = begin()
    mapper = mapper_of(node)
    mapper.suspend()
    peer.send_all((0, 1))
    Timer(1.0, mapper.resume).start()
    if what == 'map':
        answer = peer.save()
        assert len(map_file.load(folder / 'map.hoidmap').map) == 1
    else:
        request = SaveTrajectory.Request(name='first.txt', kind=what)
        answer = peer.probe.call(SaveTrajectory, 'rgbd_slam/save_trajectory', request)
        assert len(read_tum(folder / 'first.txt')) == 1
    assert answer.success, answer.message


def test_the_map_of_a_very_different_camera_can_only_be_localized_in(
    begin: Begin, folder: Path
) -> None:
    peer, _ = begin()
    peer.send_all(range(10))
    assert peer.save('good').success
    good = map_file.load(folder / 'good.hoidmap')
    camera = CAMERA.__class__(640, 480, 300.0, 300.0, 319.5, 239.5)
    map_file.save(folder / 'other.hoidmap', good._replace(camera=camera))
    refused = peer.load('other')
    assert not refused.success
    assert 'another camera, 640x480 with fx=300 fy=300' in refused.message
    assert peer.set_mode('localization').success
    assert peer.load('other').success
    refused = peer.set_mode('mapping')
    assert not refused.success
    assert 'differs too much to extend it' in refused.message


def test_the_commands_for_running_nodes_save_load_and_switch(begin: Begin, folder: Path) -> None:
    peer, _ = begin()
    peer.send_all(range(40))
    assert str(folder / 'home.hoidmap') in hoid('save-map', 'home').stdout
    assert len(map_file.load(folder / 'home.hoidmap').map) == peer.status[-1].keyframes
    assert hoid('load-map', 'home').returncode == 0
    assert hoid('set-mode', 'localization').returncode == 0
    status = peer.send(30)
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.LOCALIZATION)
    shown = hoid('status').stdout.splitlines()
    (state,) = (line for line in shown if line.startswith('state '))
    assert state.endswith('tracking, localization')  # perhaps of the last image, as none arrives
    assert shown[-1].startswith(f'map     {status.keyframes} keyframes, ')
    refused = hoid('load-map', 'missing')
    assert refused.returncode == 1
    assert 'service "/rgbd_slam/load_map"' in refused.stderr
    assert 'missing' in refused.stderr
    alone = hoid('save-map', 'home', '--namespace', 'nobody', '--wait', '0.5')
    assert alone.returncode == 1
    assert 'service "/nobody/rgbd_slam/save_map": not available after 0.5 s' in alone.stderr


def hoid(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command of hoid to its end."""
    command = [sys.executable, '-m', 'hoid_bringup', *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
