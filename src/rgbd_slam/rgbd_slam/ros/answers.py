"""Answers of services: success and a line of text, whatever is asked and whatever goes wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from hoid_common.errors import HoidError
from hoid_common.ros.diagnostics import Diagnostics

_FAILURES = 'requests that failed by a fault of this program'


class Answer(Protocol):
    """What the answers of all services have."""

    success: bool
    message: str


A = TypeVar('A', bound=Answer)


class Responder:
    """Makes services whose acts say in a line what they did, or raise.

    Args:
        node: Whose services they are.
        diagnostics: Of the node; faults are counted and logged there.
        group: Callback group of the services; None for that of the node.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._diagnostics = diagnostics
        self._group = group
        diagnostics.count(_FAILURES, 0)

    def serve(self, type_: type[Any], topic: str, act: Callable[[Any], str]) -> None:
        """Offer a service; the act gets the request."""

        def answer(request: Any, response: Any) -> Any:
            return self._answered(response, lambda: act(request))

        self._node.create_service(type_, topic, answer, callback_group=self._group)

    def failed(self, error: Exception) -> None:
        """Count and log what should not have happened."""
        self._diagnostics.count(_FAILURES)
        self._node.get_logger().error(f'a request failed: {_said(error)}')

    def _answered(self, answer: A, act: Callable[[], str]) -> A:
        try:
            text, answer.success = act(), True
        except HoidError as error:
            text, answer.success = str(error), False
        except Exception as error:  # noqa: BLE001 - who asks gets an answer
            self.failed(error)
            text, answer.success = f'failed, which is a fault of rgbd_slam: {_said(error)}', False
        answer.message = text.encode(errors='replace').decode()  # a path may not be UTF-8
        return answer


def _said(error: Exception) -> str:
    return f'{type(error).__name__}: {" ".join(str(error).split())}'
