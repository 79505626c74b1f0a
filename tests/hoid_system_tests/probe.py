"""The node of a test: publishes, subscribes, calls services, and waits with a limit."""

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
_START_S = 60.0  # limit for the start of a node on a busy machine
_DISCOVERY_S = 0.3
# A server discovers a client after the client has discovered the server; until then its response
# would be lost.
SETTLE_S = 0.1
# Deep queue, because a test must not lose messages that arrive while it does not spin.
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
        """Return a publisher; with `wait`, once it has a subscriber."""
        publisher = self.node.create_publisher(type_, topic, profile)
        if wait:
            self.spin_until(
                lambda: publisher.get_subscription_count() > 0,
                f'no subscriber of {topic}',
                _START_S,
            )
            # The subscriber may discover the publisher later, and misses messages until then.
            self.spin_for(_DISCOVERY_S)
        return publisher

    def collect(
        self, type_: type[Any], topic: str, profile: QoSProfile = _EVERYTHING, *, wait: bool = True
    ) -> list[Any]:
        """Return the list of received messages; with `wait`, once there is a publisher."""
        received: list[Any] = []
        self.node.create_subscription(type_, topic, received.append, profile)
        if wait:
            self.spin_until(
                lambda: self.node.count_publishers(self.node.resolve_topic_name(topic)) > 0,
                f'no publisher of {topic}',
                _START_S,
            )
        return received

    def call(self, type_: type[Any], name: str, request: Any, *, times: int = 1) -> Any:
        """Return the response of a service.

        Args:
            type_: Type of the service.
            name: Name of the service.
            request: The request.
            times: Number of attempts; a response may be lost if processes lack CPU time.
        """
        client = self.node.create_client(type_, name)
        self.spin_until(client.service_is_ready, f'no server of {name}', _START_S)
        self.spin_for(SETTLE_S)
        responses = [client.call_async(request)]
        for left in reversed(range(times)):
            try:
                self.spin_until(
                    lambda: any(f.done() for f in responses), f'{name} does not respond'
                )
                break
            except AssertionError:
                if not left:
                    raise
                responses.append(client.call_async(request))
        self.node.destroy_client(client)
        return next(future.result() for future in responses if future.done())

    def set_parameters(self, node: str, values: dict[str, Any]) -> None:
        """Change parameters of a node, which must accept them."""
        parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        request = SetParameters.Request(parameters=parameters)
        for result in self.call(SetParameters, f'{node}/set_parameters', request, times=3).results:
            assert result.successful, result.reason

    def spin_for(self, duration_s: float) -> None:
        """Receive messages for a time."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.02)

    def spin_until_count(self, received: list[Any], count: int, complaint: str) -> None:
        """Receive messages until the list has `count` of them."""
        self.spin_until(lambda: len(received) >= count, complaint)

    def spin_until(
        self, done: Callable[[], bool], complaint: str, timeout_s: float = TIMEOUT_S
    ) -> None:
        """Receive messages until `done()`; fail with the complaint after the timeout."""
        end_s = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < end_s, f'{complaint} within {timeout_s:.0f} s'
            self._executor.spin_once(timeout_sec=0.02)
