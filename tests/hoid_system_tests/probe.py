"""The test's own node: publishes, listens, calls services and waits with a limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from hoid_common.ros import qos

TIMEOUT_S = 15.0
_START_S = 60.0  # of a node, on a busy machine
_DISCOVERY_S = 0.3
SETTLE_S = (
    0.1  # a server knows a client later than the client the server; its answer would be lost
)
# A test does not spin while it prepares something, and must not lose what comes in meanwhile.
_EVERYTHING = QoSProfile(depth=1000, reliability=qos.OUTPUT.reliability)


class Probe:
    """A node in a context of its own."""

    def __init__(self, domain_id: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = rclpy.create_node('probe', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def publisher(
        self, type_: type[Any], topic: str, profile: QoSProfile = qos.OUTPUT, *, wait: bool = True
    ) -> Publisher:
        """Return a publisher; with `wait`, once somebody listens to it."""
        publisher = self.node.create_publisher(type_, topic, profile)
        if wait:
            self.spin_until(
                lambda: publisher.get_subscription_count() > 0,
                f'nobody listens to {topic}',
                _START_S,
            )
            # It may still have to learn of us, and drops our messages until then.
            self.spin_for(_DISCOVERY_S)
        return publisher

    def collect(
        self, type_: type[Any], topic: str, profile: QoSProfile = _EVERYTHING, *, wait: bool = True
    ) -> list[Any]:
        """Return the list that grows with each message; with `wait`, once somebody publishes."""
        received: list[Any] = []
        self.node.create_subscription(type_, topic, received.append, profile)
        if wait:
            self.spin_until(
                lambda: self.node.count_publishers(self.node.resolve_topic_name(topic)) > 0,
                f'nobody publishes {topic}',
                _START_S,
            )
        return received

    def call(self, type_: type[Any], name: str, request: Any, *, times: int = 1) -> Any:
        """Return a service's answer.

        Args:
            type_: Of the service.
            name: Of the service.
            request: What is asked.
            times: How often to ask, as an answer may be lost between starved processes.
        """
        client = self.node.create_client(type_, name)
        self.spin_until(client.service_is_ready, f'nobody offers {name}', _START_S)
        self.spin_for(SETTLE_S)
        asked = [client.call_async(request)]
        for left in reversed(range(times)):
            try:
                self.spin_until(lambda: any(f.done() for f in asked), f'{name} gives no answer')
                break
            except AssertionError:
                if not left:
                    raise
                asked.append(client.call_async(request))
        self.node.destroy_client(client)
        return next(future.result() for future in asked if future.done())

    def set_parameters(self, node: str, values: dict[str, Any]) -> None:
        """Change parameters of a node; it must agree."""
        parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        request = SetParameters.Request(parameters=parameters)
        for result in self.call(SetParameters, f'{node}/set_parameters', request, times=3).results:
            assert result.successful, result.reason

    def spin_for(self, duration_s: float) -> None:
        """Let messages come in."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.02)

    def spin_until_count(self, received: list[Any], count: int, complaint: str) -> None:
        """Let messages come in until so many are there."""
        self.spin_until(lambda: len(received) >= count, complaint)

    def spin_until(
        self, done: Callable[[], bool], complaint: str, timeout_s: float = TIMEOUT_S
    ) -> None:
        """Let messages come in until `done()`; if it never is, fail with the complaint."""
        end_s = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < end_s, f'{complaint} within {timeout_s:.0f} s'
            self._executor.spin_once(timeout_sec=0.02)
