"""Requests to every service of the nodes, which must all be answered after each case."""

from __future__ import annotations

import time
from typing import Any

from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory, SetMode
from std_srvs.srv import SetBool, Trigger

from hoid_benchmarks.faults.live.sender import Sender
from hoid_bringup.live.node_specs import DETECTOR, SCENE, SLAM
from hoid_common import topics

ANSWER_S = 20.0
_NAME = 'requested'
# All services except reset and pause, which would change the state for the next case.
_REQUESTS: tuple[tuple[str, str, type[Any], dict[str, Any]], ...] = (
    (SLAM, topics.SAVE_MAP, SaveMap, {'name': _NAME}),
    (SLAM, topics.SAVE_TRAJECTORY, SaveTrajectory, {'name': _NAME}),
    (SCENE, topics.SAVE_CLOUD, SaveMap, {'name': _NAME}),
    (SCENE, topics.SAVE_GRID, SaveMap, {'name': _NAME}),
    (SLAM, topics.LOAD_MAP, LoadMap, {'name': 'not there'}),
    (SLAM, topics.SET_MODE, SetMode, {'mode': SetMode.Request.MAPPING}),
    (SLAM, topics.RESUME, Trigger, {}),
    (DETECTOR, topics.ENABLE, SetBool, {'data': True}),
)


class Services:
    """Clients of the services of the running nodes.

    Args:
        sender: Publishes images while an answer is awaited.
        nodes: Names of the running nodes.
    """

    def __init__(self, sender: Sender, nodes: tuple[str, ...]) -> None:
        self._sender = sender
        self._requests = [
            (self.client(type_, node, service), type_.Request(**fields))
            for node, service, type_, fields in _REQUESTS
            if node in nodes
        ]

    def client(self, type_: type[Any], node: str, service: str) -> Any:
        """Return a client for a private service of a node."""
        return self._sender.node.create_client(type_, service.replace('~', node))

    def answer(self, client: Any, request: Any, limit_s: float = ANSWER_S) -> Any:
        """Return the response to a request; None after the time limit (s)."""
        future = client.call_async(request)
        end_s = time.monotonic() + limit_s
        while not future.done() and time.monotonic() < end_s:
            self._sender.send()
        return future.result() if future.done() else None

    def unanswered(self, limit_s: float) -> tuple[str, ...]:
        """Return the names of the services that do not respond within the limit (s)."""
        return tuple(
            client.srv_name
            for client, request in self._requests
            if self.answer(client, request, limit_s) is None
        )
