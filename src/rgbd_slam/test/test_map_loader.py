"""A map is loaded into a new session, and its keyframes are published with their origin."""

from __future__ import annotations

from threading import Event
from typing import Any

import pytest

from hoid_common.slam_status import SlamState
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros import map_loader
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.session import SlamSession

from .direct_calls import DirectCalls
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


class Keyframes:
    """Stands for the publisher of keyframes; keeps what it is told."""

    def __init__(self) -> None:
        self.loaded: list[tuple[str, list[int], list[int], bool]] = []

    def note_loaded(
        self, source: str, saved_uids: IntArray, loaded_uids: IntArray, *, keep: bool
    ) -> None:
        self.loaded.append((source, saved_uids.tolist(), loaded_uids.tolist(), keep))


def test_a_loaded_map_is_used_and_its_keyframes_are_published(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_loader, 'NodeThread', DirectCalls)
    world = World()
    before, session = (SlamSession(CAMERA, SlamConfig(), RobotFrames()) for _ in range(2))
    poses = sway(90)
    for n in range(5):
        before.process(world.features(n * PERIOD_NS, poses[n]))
    node: Any = FakeNode()
    keyframes: Any = Keyframes()
    done = Event()
    loader = MapLoader(node, lambda: session, keyframes, lambda: None)
    content = before.map.export()
    loader.load_first(session, content, '/maps/a.hoidmap', done.set, extend=True)
    assert done.is_set()
    assert not node.warnings
    uids = session.map.keyframes().uids.tolist()
    saved = before.map.keyframes().uids.tolist()
    assert keyframes.loaded == [('/maps/a.hoidmap', saved, uids, False)]
    found = session.process(world.features(5 * PERIOD_NS, poses[5]))
    assert found.status.state is SlamState.TRACKING
    assert found.status.keyframes == before.slam.stats.num_keyframes
