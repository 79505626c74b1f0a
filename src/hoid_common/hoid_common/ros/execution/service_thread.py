"""Services of a node that take long, answered in a thread of their own."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event, Thread, get_ident

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from hoid_common.ros.execution.executor import GroupExecutor, ThreadCallbackGroup

_PAUSE_S = 0.1  # after a failure, which may come again at once
_END_S = 2.0


class ServiceThread:
    """A thread that lives as long as the node: no request, whatever it asks for, can end it.

    Make the services with `group` as their callback group, then `start`.

    Args:
        node: Whose services they are; its own executor leaves them alone.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = ThreadCallbackGroup()
        self._executor = GroupExecutor(node, self._group)
        self._is_ended = Event()
        self._thread = Thread(target=self._run, name='services', daemon=True)

    @property
    def group(self) -> CallbackGroup:
        """Return the callback group to make services with."""
        return self._group

    def start(self, on_failure: Callable[[Exception], None]) -> None:
        """Begin to answer.

        Args:
            on_failure: Told, in the thread, of what a callback raised.
        """
        self._on_failure = on_failure
        self._thread.start()

    def close(self) -> None:
        """End the thread, unless it is at work; then the process' end ends it."""
        self._is_ended.set()
        self._executor.shutdown(timeout_sec=0.0)
        if self._thread.is_alive():
            self._thread.join(_END_S)

    def _run(self) -> None:
        self._group.thread_id = get_ident()
        while not self._is_ended.is_set():
            try:
                self._executor.spin_once()
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, the next one is answered
                if not self._node.context.ok():
                    return
                self._on_failure(error)
                time.sleep(_PAUSE_S)
