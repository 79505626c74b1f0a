"""Service handlers that always respond: success and a line of text, also after an error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from hoid_common.errors import HoidError
from hoid_common.ros.diagnostics import Diagnostics

_FAILURES = 'requests that failed by a fault of this program'


class ServiceHandlers:
    """Offers services whose handlers return a line of text for success, or raise.

    Args:
        node: The node that offers the services.
        diagnostics: Diagnostics of the node, in which faults are counted.
        group: Callback group of the services; None: the default group of the node.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._diagnostics = diagnostics
        self._group = group
        diagnostics.count(_FAILURES, 0)

    def add(self, type_: type[Any], topic: str, handle: Callable[[Any], str]) -> None:
        """Offer a service.

        Args:
            type_: Type of the service, whose response has the fields `success` and `message`.
            topic: Name of the service.
            handle: Called with the request; returns the message of a successful response. If it
                raises a HoidError, the response has no success, and the text of the error as its
                message. Any other error is reported as a fault as well.
        """
        self.add_with_response(type_, topic, lambda request, _: handle(request))

    def add_with_response(
        self, type_: type[Any], topic: str, handle: Callable[[Any, Any], str]
    ) -> None:
        """Offer a service whose handler fills further fields of the response.

        Args:
            type_: As in `add`.
            topic: Name of the service.
            handle: As in `add`, but called with the request and the response.
        """

        def respond(request: Any, response: Any) -> Any:
            try:
                text, response.success = handle(request, response), True
            except HoidError as error:
                text, response.success = str(error), False
            except Exception as error:  # noqa: BLE001 - every request gets a response
                self.report_fault(error)
                text = f'failed, which is a fault of rgbd_slam: {_one_line(error)}'
                response.success = False
            # A path may not be UTF-8, which a message must be.
            response.message = text.encode(errors='replace').decode()
            return response

        self._node.create_service(type_, topic, respond, callback_group=self._group)

    def report_fault(self, error: Exception) -> None:
        """Count and log an unexpected error, which is a fault of this program."""
        self._diagnostics.count(_FAILURES)
        self._node.get_logger().error(f'a request failed: {_one_line(error)}')


def _one_line(error: Exception) -> str:
    return f'{type(error).__name__}: {" ".join(str(error).split())}'
