"""A map that cannot be loaded completely gives one line in the log, and the session goes on."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import Any

import pytest

from hoid_common.slam_status import SlamState
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.robot_map import LoadedMap
from rgbd_slam.ros import map_loader
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.session import SlamSession

from .world import CAMERA, PERIOD_NS, World, sway


class FakeNode:
    """A node that keeps the warnings of its log."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.has_warned = Event()

    def get_logger(self) -> FakeNode:
        return self

    def warning(self, text: str) -> None:
        self.warnings.append(text)
        self.has_warned.set()


class DirectCalls:
    """Calls functions in the thread that asks for it."""

    def __init__(self, _: object) -> None:
        pass

    def call(self, function: Callable[[], object]) -> object:
        return function()


class FullDisk:
    """Stands for the scene client on a full disk: the dense map cannot be written."""

    def use_keyframes(self, loaded: LoadedMap, *, keep: bool) -> None:
        pass

    def prepare(self, *_: object) -> tuple[str, Callable[[], None]]:
        raise OSError(28, 'No space left on device', 'loaded-0.npz')


def test_a_full_disk_costs_the_dense_map_and_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_loader, 'NodeThread', DirectCalls)
    world = World()
    before, session = (SlamSession(CAMERA, SlamConfig(), RobotFrames()) for _ in range(2))
    poses = sway(90)
    for n in range(5):
        before.process(world.features(n * PERIOD_NS, poses[n]))
    node: Any = FakeNode()
    scene: Any = FullDisk()
    done = Event()
    loader = MapLoader(node, lambda: session, scene, lambda: None)
    loader.load_first(session, before.robot_map.export(), done.set, extend=True)
    assert done.is_set()
    assert node.has_warned.wait(10.0)
    assert len(node.warnings) == 1
    assert node.warnings[0].startswith('the map is not loaded completely: ')
    assert 'No space left on device' in node.warnings[0]
    found = session.process(world.features(5 * PERIOD_NS, poses[5]))
    assert found.status.state is SlamState.TRACKING
    assert found.status.keyframes == before.slam.stats.num_keyframes
