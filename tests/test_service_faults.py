"""Services of rgbd_slam answer every request, even with invalid names and damaged files."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory, SetMode

from hoid_system_tests.point_world import PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg
from rgbd_slam.store import map_file

pytestmark = pytest.mark.thorough

LONG = ('x' * 247, 'x' * 248, 'x' * 256, 'ä' * 130, 'x' * 100_000)
NAMES = (*LONG, '\n', '.', '../x', 'a.exe', '%s')
SERVICES: tuple[tuple[str, type[Any]], ...] = (
    ('rgbd_slam/save_map', SaveMap),
    ('hoid_scene/save_cloud', SaveMap),
    ('hoid_scene/save_grid', SaveMap),
    ('hoid_scene/save_objects', SaveMap),
    ('rgbd_slam/save_trajectory', SaveTrajectory),
    ('rgbd_slam/load_map', LoadMap),
)
CHANGES = (
    'DELETE FROM meta',
    'DELETE FROM keyframes',
    "UPDATE meta SET camera = x'00'",
    'UPDATE points SET points = zeroblob(1000000)',
    'DROP TABLE loops',
    'CREATE VIEW more AS SELECT 1',
    'CREATE TRIGGER t AFTER INSERT ON meta BEGIN DELETE FROM meta; END',
    'PRAGMA user_version = 5',
)


@pytest.fixture
def peer(start: Start, probe: Probe, folder: Path) -> SlamPeer:
    for package in ('rgbd_slam', 'hoid_scene'):
        start(package, f'{package}_node', {'map_directory': str(folder)})
    peer = SlamPeer(probe)
    peer.begin()
    for i in range(10):
        assert track(peer, i).state == SlamStatus.TRACKING
    return peer


def track(peer: SlamPeer, i: int) -> SlamStatus:
    seen = PointWorld(3000).features(pose_after(i, turn_rad=0.01), START_NS + i * PERIOD_NS)
    return peer.answer_to(features_msg(seen))


def test_every_request_is_answered_in_one_line(peer: SlamPeer) -> None:
    for name, type_ in SERVICES:
        for text in NAMES:
            answer = peer.probe.call(type_, name, type_.Request(name=text))
            assert '\n' not in answer.message
            assert len(answer.message) < 400
            assert not answer.success or text == '%s'
    answer = peer.probe.call(SetMode, 'rgbd_slam/set_mode', SetMode.Request(mode='x' * 100_000))
    assert not answer.success
    assert len(answer.message) < 200
    message, values = peer.diagnosis()
    assert 'fault' not in message
    assert values['requests that failed by a fault of this program'] == '0'
    assert peer.save('good').success
    assert track(peer, 10).state == SlamStatus.TRACKING


def test_damaged_maps_are_refused_and_a_valid_one_is_loaded(peer: SlamPeer, folder: Path) -> None:
    assert peer.save('good').success
    good = (folder / 'good.hoidmap').read_bytes()
    for change in CHANGES:
        (folder / 'bad.hoidmap').write_bytes(good)
        with closing(sqlite3.connect(folder / 'bad.hoidmap')) as connection:
            connection.execute(change)
            connection.commit()
        answer = peer.load('bad')
        assert not answer.success
        assert 'bad.hoidmap: ' in answer.message, change
        assert '\n' not in answer.message
        assert 'fault' not in answer.message
    assert peer.load('good').success
    assert peer.set_mode('localization').success
    assert track(peer, 5).state == SlamStatus.TRACKING


def test_a_file_of_one_kind_never_replaces_one_of_another(peer: SlamPeer, folder: Path) -> None:
    assert peer.save('good').success
    before = (folder / 'good.hoidmap').read_bytes()
    for name, type_ in (
        ('rgbd_slam/save_trajectory', SaveTrajectory),
        ('hoid_scene/save_cloud', SaveMap),
    ):
        answer = peer.probe.call(type_, name, type_.Request(name='good.hoidmap'))
        assert not answer.success
        assert 'ends in ' in answer.message or 'no object map' in answer.message
    request = SaveTrajectory.Request(name='good')
    assert peer.probe.call(SaveTrajectory, 'rgbd_slam/save_trajectory', request).success
    assert (folder / 'good.hoidmap').read_bytes() == before
    assert map_file.load(folder / 'good.hoidmap')
    assert sorted(p.name for p in folder.glob('[!.]*')) == ['good.hoidmap', 'good.txt']
