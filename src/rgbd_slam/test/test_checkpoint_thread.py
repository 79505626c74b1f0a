"""The threads that read and write checkpoints, while the session changes beside them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros import checkpoint_thread
from rgbd_slam.ros.checkpoints import Checkpoints
from rgbd_slam.ros.session_lifecycle import owned_map
from rgbd_slam.session import SlamSession
from rgbd_slam.store.map_writer import MapWriter
from rgbd_slam.store.running_map import RunningMap

from .world import CAMERA, PERIOD_NS, World, sway

LIMIT_S = 20.0  # for the threads


class Fake:
    """A node, its log, and its diagnostics: every call has no effect."""

    def __getattr__(self, name: str) -> Callable[..., Fake]:
        return lambda *_, **__: self

    def get_fully_qualified_name(self) -> str:
        return '/rgbd_slam'


class DirectCalls:
    """Calls functions in the thread that asks for it, and calls `before` with their number."""

    before: Callable[[int], None] = staticmethod(lambda _: None)

    def __init__(self, _: object) -> None:
        self._count = 0

    def call(self, function: Callable[[], object]) -> object:
        DirectCalls.before(self._count)
        self._count += 1
        return function()


def new_checkpoints(
    folder: Path, monkeypatch: pytest.MonkeyPatch, session: Callable[[], SlamSession | None]
) -> Checkpoints:
    monkeypatch.setattr(checkpoint_thread, 'NodeThread', DirectCalls)
    config = SlamNodeConfig(map_directory=str(folder), checkpoint_period_s=0.05)
    fake: Any = Fake()
    return Checkpoints(fake, config, owned_map(fake, config), fake, session)


def session_of(num_images: int) -> SlamSession:
    session, world, poses = SlamSession(CAMERA, SlamConfig(), RobotFrames()), World(), sway(90)
    for n in range(num_images):
        session.process(world.features(n * PERIOD_NS, poses[n]))
    return session


def test_a_reset_while_the_checkpoint_is_read_discards_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_reading, may_end = Event(), Event()

    def read(_: RunningMap) -> None:
        is_reading.set()
        may_end.wait(LIMIT_S)

    errors: list[object] = []
    monkeypatch.setattr(threading, 'excepthook', errors.append)
    monkeypatch.setattr(RunningMap, 'read', read)
    tested = new_checkpoints(tmp_path, monkeypatch, lambda: None)
    assert is_reading.wait(LIMIT_S)
    reader = next(t for t in threading.enumerate() if t.name == 'read checkpoint')
    tested.discard()
    may_end.set()
    reader.join(LIMIT_S)
    tested.close(is_asked_for=True)
    assert errors == []
    assert not tested.has_stored


def test_a_checkpoint_has_the_header_of_its_own_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another camera begins a new session between two parts of a copy of the old map."""
    sessions = [session_of(5), session_of(1)]
    current = [sessions[0]]

    def change_camera(number: int) -> None:
        if number == 1:  # after the checkpoint was begun, before its first part is copied
            current[0] = sessions[1]

    written: list[Atlas] = []
    is_written = Event()
    append = MapWriter.append

    def record(writer: MapWriter, *arguments: Any) -> bool:
        is_complete = append(writer, *arguments)
        if is_complete:
            written.append(writer.atlas)
            is_written.set()
        return is_complete

    monkeypatch.setattr(DirectCalls, 'before', staticmethod(change_camera))
    monkeypatch.setattr(MapWriter, 'append', record)
    tested = new_checkpoints(tmp_path, monkeypatch, lambda: current[0])
    assert is_written.wait(LIMIT_S)
    tested.close(is_asked_for=True)
    assert written[0] is sessions[1].map.atlas
