"""Map files and modes through real clients: saved, loaded, extended, merged, refused."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

from hoid_bringup.live.supervisor import Supervisor
from hoid_common import se3
from hoid_common.io.tum_text import read_tum
from hoid_common.ros import conversions
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, mapper_of
from hoid_system_tests.repeated_map import repeated
from hoid_system_tests.slam_peer import (
    PERIOD_NS,
    START_NS,
    SlamPeer,
    features_msg,
)
from rgbd_slam.store import map_file

pytestmark = pytest.mark.thorough


def camera_at(i: int) -> FloatArray:
    """Return the (4, 4) T_world_camera of place i."""
    return pose_after(i, turn_rad=0.01)


class Peer(SlamPeer):
    """Publishes the features of images at places of a point world."""

    def __init__(self, probe: Probe) -> None:
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        super().__init__(probe)
        self.world, self.num_sent = PointWorld(3000), 0
        self.begin()

    def send(self, *places: int) -> list[SlamStatus]:
        """Send images and return the status of each."""
        answers = []
        for place in places:
            stamp_ns = START_NS + self.num_sent * PERIOD_NS
            self.num_sent += 1
            seen = self.world.features(camera_at(place), stamp_ns)
            answers.append(self.answer_to(features_msg(seen)))
        return answers

    def last_pose(self) -> FloatArray:
        """Return the (4, 4) T_map_camera of the last image."""
        return self.pose(START_NS + (self.num_sent - 1) * PERIOD_NS)


@pytest.fixture
def begin(start: Start, probe: Probe, folder: Path) -> Callable[..., tuple[Peer, Supervisor]]:
    """Start a node and return a peer of it."""

    def begin(**params: Any) -> tuple[Peer, Supervisor]:
        probe.spin_until(
            lambda: probe.node.count_subscribers('features') == 0,
            'the previous node does not leave the graph',
            30.0,
        )
        given = {'map_directory': str(folder)} | params
        supervisor = start('rgbd_slam', 'rgbd_slam_node', given)
        return Peer(probe), supervisor

    return begin


def check_pose(peer: Peer, place: int) -> None:
    """Check the last pose in the first session's map, within 2 cm and 1 degree."""
    error = se3.log(se3.inverse(T_BODY_OPTICAL @ camera_at(place)) @ peer.last_pose())
    assert np.linalg.norm(error[3:]) < 0.02
    assert np.degrees(np.linalg.norm(error[:3])) < 1


Begin = Callable[..., tuple[Peer, Supervisor]]


def test_a_saved_map_is_used_and_extended_by_a_later_node(begin: Begin, folder: Path) -> None:
    peer, supervisor = begin()
    peer.send(*range(40))
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
    status = peer.send(30)[-1]  # not where the first session started
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.LOCALIZATION)
    assert status.keyframes == len(saved.map)
    check_pose(peer, 30)
    statuses = peer.send(*range(29, 5, -1), *range(30, 45))
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    check_pose(peer, 44)
    assert peer.save('again').success
    assert map_file.load(folder / 'again.hoidmap').map.digest() == saved.map.digest()

    answer = peer.set_mode('mapping')
    assert answer.success, answer.message
    statuses = peer.send(*range(45, 100))
    assert {status.mode for status in statuses} == {SlamStatus.MAPPING}
    peer.probe.spin_until(
        lambda: peer.send(99)[-1].keyframes > len(saved.map), 'mapping does not continue', 30.0
    )
    check_pose(peer, 99)
    assert peer.save('more').success
    more = map_file.load(folder / 'more.hoidmap').map
    assert len(more) > len(saved.map)
    assert (more.map_id == 0).all()


def test_a_second_session_is_merged_with_a_loaded_map(begin: Begin, folder: Path) -> None:
    peer, supervisor = begin()
    peer.send(*range(70))
    assert peer.save('first').success
    supervisor.stop()

    peer, _ = begin()
    peer.send(*range(150, 110, -1))  # a new map in a frame of its own
    answer = peer.load('first', merge=True)
    assert answer.success, answer.message
    statuses = peer.send(110)
    assert statuses[-1].state == SlamStatus.TRACKING
    assert statuses[-1].maps == 2
    statuses = peer.send(*range(109, 10, -1))
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    peer.probe.spin_until(lambda: peer.send(10)[-1].maps == 1, 'the maps are not merged', 30.0)
    check_pose(peer, 10)
    assert peer.status[-1].merges == 1
    odom = np.array([conversions.pose_from_msg(msg.pose.pose) for msg in peer.odom])
    steps = np.linalg.norm(np.diff(odom[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.03
    assert peer.save('both').success
    both = map_file.load(folder / 'both.hoidmap').map
    assert (both.map_id == 0).all()


def test_a_map_is_loaded_at_the_start(begin: Begin) -> None:
    peer, supervisor = begin()
    peer.send(*range(20))
    assert peer.save('home').success
    supervisor.stop()
    peer, _ = begin(map_file='home', mode='localization')
    status = peer.send(12)[-1]
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.LOCALIZATION)
    check_pose(peer, 12)


def test_reset_discards_a_loaded_map(begin: Begin) -> None:
    peer, _ = begin()
    peer.send(*range(20))
    assert peer.save().success
    assert peer.set_mode('localization').success
    assert peer.load().success
    client = peer.probe.node.create_client(Trigger, 'rgbd_slam/reset')
    peer.probe.spin_until(client.service_is_ready, 'no reset')
    answer = client.call_async(Trigger.Request())
    peer.probe.spin_until(answer.done, 'no reset', 60.0)  # it starts a process
    assert answer.result().success
    status = peer.send(3)[-1]
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.MAPPING)
    assert status.keyframes == 1


def saved_large_map(peer: Peer, folder: Path) -> map_file.MapFile:
    """Save a map of 300 keyframes or more as large.hoidmap, and return it."""
    assert peer.save('one').success
    one = map_file.load(folder / 'one.hoidmap')
    large = one._replace(map=repeated(one.map, 1 + 300 // len(one.map)), uids=None)
    map_file.save(folder / 'large.hoidmap', large)
    return large


def ready_client(peer: Peer, type_: type[Any], name: str) -> Any:
    client = peer.probe.node.create_client(type_, f'rgbd_slam/{name}')
    peer.probe.spin_until(client.service_is_ready, f'no {name}')
    return client


@pytest.mark.alone
def test_images_are_tracked_while_a_large_map_is_saved(begin: Begin, folder: Path) -> None:
    peer, _ = begin()
    peer.send(*range(40))
    large = saved_large_map(peer, folder)
    assert peer.load('large').success
    assert peer.set_mode('localization').success
    peer.send(39)
    client = ready_client(peer, SaveMap, 'save_map')
    waits_s: list[float] = []
    start_s = time.monotonic()
    saving = client.call_async(SaveMap.Request(name='again'))
    while not saving.done():
        sent_s = time.monotonic()
        peer.send(39)
        waits_s.append(time.monotonic() - sent_s)
    saving_s = time.monotonic() - start_s
    assert saving.result().success
    assert map_file.load(folder / 'again.hoidmap').map.digest() == large.map.digest()
    # A busy machine makes both slow.
    assert len(waits_s) >= 4
    assert max(waits_s) < saving_s / 2
    assert peer.status[-1].frames_processed == peer.num_sent


@pytest.mark.alone
@pytest.mark.parametrize('merge', [False, True])
def test_images_are_tracked_while_a_large_map_is_loaded(
    begin: Begin, folder: Path, merge: bool
) -> None:
    peer, _ = begin()
    peer.send(*range(40))
    large = saved_large_map(peer, folder)
    client = ready_client(peer, LoadMap, 'load_map')
    loading = client.call_async(LoadMap.Request(name='large', merge=merge))
    statuses, start_s = [], time.monotonic()
    while not loading.done():
        statuses += peer.send(39)
    assert loading.result().success, loading.result().message
    loading_s = time.monotonic() - start_s
    # Tracking continues in the old map; the first image after that is found in the new one.
    assert len([status for status in statuses if status.maps == 1]) > 4
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    assert len(statuses) / loading_s > 5  # images per second, on a busy machine
    status = peer.send(39)[-1]
    num_maps = len(np.unique(large.map.map_id)) + merge
    assert (status.state, status.maps) == (SlamStatus.TRACKING, num_maps)
    assert num_maps > 50
    check_pose(peer, 39)
    assert peer.save('again').success
    saved = map_file.load(folder / 'again.hoidmap').map
    if merge:  # the running map is still there, as the youngest
        assert len(saved) > len(large.map)
        assert np.isin(large.map.stamp_ns, saved.stamp_ns[saved.map_id < num_maps - 1]).all()
    else:
        assert saved.digest() == large.map.digest()


@contextmanager
def suspended_mapper(node: Supervisor) -> Iterator[None]:
    """Suspend a node's mapper, so that it seems to be busy."""
    mapper = mapper_of(node)
    mapper.suspend()
    try:
        yield
    finally:
        mapper.resume()


@pytest.mark.alone
@pytest.mark.parametrize(
    ('name', 'type_', 'request_'),
    [
        ('save_trajectory', SaveTrajectory, SaveTrajectory.Request(kind='final')),
        ('load_map', LoadMap, LoadMap.Request(merge=True)),
    ],
)
def test_images_are_tracked_while_a_service_waits_for_the_mapper(
    begin: Begin, folder: Path, name: str, type_: type[Any], request_: Any
) -> None:
    peer, node = begin()
    peer.send(*range(10))
    assert peer.save().success
    client = ready_client(peer, type_, name)
    with suspended_mapper(node):
        statuses = peer.send(*range(10, 60))
        assert statuses[-1].mapper_queue > 0
        answer = client.call_async(request_)
        peer.probe.spin_for(0.5)  # the service waits for the mapper
        statuses += peer.send(*range(60, 50, -1))
        assert {status.state for status in statuses} == {SlamStatus.TRACKING}
        assert not answer.done()
    peer.probe.spin_until(answer.done, f'{name} gives no answer', 60.0)
    assert answer.result().success, answer.result().message
    if name == 'save_trajectory':
        assert len(read_tum(folder / 'trajectory.txt')) == 70


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
    peer.send(*range(10))
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
    assert peer.send(10)[-1].state == SlamStatus.TRACKING
    assert peer.save('after').success
    assert map_file.load(folder / 'after.hoidmap').map.digest() == digest


def test_a_map_is_saved_once_the_mapper_has_inserted_its_first_keyframe(begin: Begin) -> None:
    peer, node = begin()
    mapper = mapper_of(node)
    mapper.suspend()
    peer.send(0, 1)
    Timer(1.0, mapper.resume).start()
    answer = peer.save()
    assert answer.success, answer.message
    assert answer.message.startswith('1 keyframes and ')


def test_the_map_of_a_very_different_camera_can_only_be_localized_in(
    begin: Begin, folder: Path
) -> None:
    peer, _ = begin()
    peer.send(*range(10))
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
    peer.send(*range(40))
    assert str(folder / 'home.hoidmap') in hoid('save-map', 'home').stdout
    assert len(map_file.load(folder / 'home.hoidmap').map) == peer.status[-1].keyframes
    assert hoid('load-map', 'home').returncode == 0
    assert hoid('set-mode', 'localization').returncode == 0
    status = peer.send(30)[-1]
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
