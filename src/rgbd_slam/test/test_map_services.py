"""The response of a service says what the session does from now on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hoid_msgs.srv import SetMode

from hoid_common import topics
from hoid_common.slam_status import SlamMode
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.ros import map_services
from rgbd_slam.ros.map_services import MapServices

from .direct_calls import DirectCalls


class FakeNode:
    """A node, its log, its diagnostics and the thread of its services."""

    def __init__(self, *_: object) -> None:
        self.group = self
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.groups: dict[str, object] = {}

    def create_service(
        self, _: object, name: str, respond: Callable[[Any, Any], Any], *, callback_group: object
    ) -> None:
        self.services[name], self.groups[name] = respond, callback_group

    def create_client(self, *_: object) -> None:
        pass

    def get_logger(self) -> FakeNode:
        return self

    def count(self, *_: object) -> None:
        pass

    def start(self, *_: object) -> None:
        pass


@pytest.mark.parametrize(
    ('is_settled', 'message'),
    [
        (True, 'localization: the map stays as it is'),
        (False, 'localization: the map stays as it is once a running adjustment has ended'),
    ],
)
def test_a_mode_that_was_switched_is_a_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_settled: bool, message: str
) -> None:
    monkeypatch.setattr(map_services, 'NodeThread', DirectCalls)
    monkeypatch.setattr(map_services, 'ServiceThread', FakeNode)
    monkeypatch.setattr(map_services, '_SETTLE_S', 0.0)
    modes: list[SlamMode] = []
    mapper = SimpleNamespace(is_settled=is_settled)
    slam_map = SimpleNamespace(mapper=mapper, update=lambda: None)
    session: Any = SimpleNamespace(map=slam_map, set_mode=modes.append)
    node, other = FakeNode(), FakeNode()
    fake: Any = node
    unused: Any = other
    config = SlamNodeConfig(map_directory=str(tmp_path))
    MapServices(fake, config, lambda: session, unused, unused, fake, unused)
    request = SetMode.Request(mode='localization')
    response = node.services[topics.SET_MODE](request, SetMode.Response())
    assert modes == [SlamMode.LOCALIZATION]
    assert response.success
    assert response.message == message
    # A request for a file, on a disk that does not respond, must not delay it.
    assert node.groups[topics.SET_MODE] is not node.groups[topics.SAVE_MAP]
