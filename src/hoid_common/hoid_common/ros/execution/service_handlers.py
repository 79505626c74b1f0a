"""Services that always respond with success or failure and a line of text, even after an error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from hoid_common.errors import HoidError
from hoid_common.ros.diagnostics import Diagnostics

_FAILURES = 'requests that failed by a fault of this program'


class ServiceHandlers:
    """Offers services whose handlers return a line of text for success, or raise."""

    def __init__(
        self, node: Node, diagnostics: Diagnostics, group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._diagnostics = diagnostics
        self._group = group
        diagnostics.count(_FAILURES, 0)

    def add(self, type_: type[Any], topic: str, handle: Callable[[Any], str]) -> None:
        """Offer a service, whose response has the fields `success` and `message`.

        `handle` is called with the request and returns the message. If it raises a HoidError,
        `success` is False and the message is its text; any other error is also counted and logged
        as a fault of the node.
        """
        self.add_with_response(type_, topic, lambda request, _: handle(request))

    def add_with_response(
        self, type_: type[Any], topic: str, handle: Callable[[Any, Any], str]
    ) -> None:
        """Offer a service as `add` does; `handle` also gets the response, to set its fields."""

        def respond(request: Any, response: Any) -> Any:
            try:
                text, response.success = handle(request, response), True
            except HoidError as error:
                text, response.success = str(error), False
            except Exception as error:  # noqa: BLE001 - every request gets a response
                self.report_fault(error)
                text = f'failed by a fault of {self._node.get_name()}: {_one_line(error)}'
                response.success = False
            # A path may not be UTF-8, which a message must be.
            response.message = text.encode(errors='replace').decode()
            return response

        self._node.create_service(type_, topic, respond, callback_group=self._group)

    def report_fault(self, error: Exception) -> None:
        self._diagnostics.count(_FAILURES)
        self._node.get_logger().error(f'a request failed: {_one_line(error)}')


def _one_line(error: Exception) -> str:
    return f'{type(error).__name__}: {" ".join(str(error).split())}'
