"""Images are tracked while services save, load or wait for a map."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory

from hoid_bringup.live.supervisor import Supervisor
from hoid_common.io.tum_text import read_tum
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, mapper_of
from hoid_system_tests.repeated_map import repeated
from hoid_system_tests.running_camera import RunningCamera
from rgbd_slam.store import map_file

pytestmark = [pytest.mark.thorough, pytest.mark.alone]


@pytest.fixture
def running(start: Start, probe: Probe, folder: Path) -> tuple[RunningCamera, Supervisor]:
    """A camera and the node that tracks it."""
    node = start('rgbd_slam', 'rgbd_slam_node', {'map_directory': str(folder)})
    peer = RunningCamera(probe)
    peer.begin()
    return peer, node


def saved_large_map(peer: RunningCamera, folder: Path) -> map_file.MapFile:
    """Save a map of 300 keyframes or more as large.hoidmap, and return it."""
    assert peer.save('one').success
    one = map_file.load(folder / 'one.hoidmap')
    large = one._replace(map=repeated(one.map, 1 + 300 // len(one.map)), uids=None)
    map_file.save(folder / 'large.hoidmap', large)
    return large


def ready_client(peer: RunningCamera, type_: type[Any], name: str) -> Any:
    client = peer.probe.node.create_client(type_, f'rgbd_slam/{name}')
    peer.probe.spin_until(client.service_is_ready, f'no {name}')
    return client


def test_images_are_tracked_while_a_large_map_is_saved(
    running: tuple[RunningCamera, Supervisor], folder: Path
) -> None:
    peer, _ = running
    peer.send_all(range(40))
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
    assert peer.status[-1].frames_processed == 41 + len(waits_s)


@pytest.mark.parametrize('merge', [False, True])
def test_images_are_tracked_while_a_large_map_is_loaded(
    running: tuple[RunningCamera, Supervisor], folder: Path, merge: bool
) -> None:
    peer, _ = running
    peer.send_all(range(40))
    large = saved_large_map(peer, folder)
    client = ready_client(peer, LoadMap, 'load_map')
    loading = client.call_async(LoadMap.Request(name='large', merge=merge))
    statuses, start_s = [], time.monotonic()
    while not loading.done():
        statuses.append(peer.send(39))
    assert loading.result().success, loading.result().message
    loading_s = time.monotonic() - start_s
    # Tracking continues in the old map; the first image after that is found in the new one.
    assert len([status for status in statuses if status.maps == 1]) > 4
    assert {status.state for status in statuses} == {SlamStatus.TRACKING}
    assert len(statuses) / loading_s > 5  # images per second, on a busy machine
    status = peer.send(39)
    num_maps = len(np.unique(large.map.map_id)) + merge
    assert (status.state, status.maps) == (SlamStatus.TRACKING, num_maps)
    assert num_maps > 50
    peer.check_pose(39)
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


@pytest.mark.parametrize(
    ('name', 'type_', 'request_'),
    [
        ('save_trajectory', SaveTrajectory, SaveTrajectory.Request(kind='final')),
        ('load_map', LoadMap, LoadMap.Request(merge=True)),
    ],
)
def test_images_are_tracked_while_a_service_waits_for_the_mapper(
    running: tuple[RunningCamera, Supervisor],
    folder: Path,
    name: str,
    type_: type[Any],
    request_: Any,
) -> None:
    peer, node = running
    peer.send_all(range(10))
    assert peer.save().success
    client = ready_client(peer, type_, name)
    with suspended_mapper(node):
        statuses = peer.send_all(range(10, 60))
        assert statuses[-1].mapper_queue > 0
        answer = client.call_async(request_)
        peer.probe.spin_for(0.5)  # the service waits for the mapper
        statuses += peer.send_all(range(60, 50, -1))
        assert {status.state for status in statuses} == {SlamStatus.TRACKING}
        assert not answer.done()
    peer.probe.spin_until(answer.done, f'{name} gives no answer', 60.0)
    assert answer.result().success, answer.result().message
    if name == 'save_trajectory':
        assert len(read_tum(folder / 'trajectory.txt')) == 70
