"""A thread for services of a node that take long, such as saving a map."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event, Thread, get_ident

from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from hoid_common.ros.execution.executor import GroupExecutor, ThreadCallbackGroup

# Chosen: pause after an error, so that repeated errors do not keep a whole processor core busy.
_PAUSE_S = 0.1
# Chosen: how long the end of the node waits for the running service to return.
_JOIN_TIMEOUT_S = 2.0


class ServiceThread:
    """Runs the services of a callback group in a thread, so that they do not block the node.

    Create the services with `group`, then call `start`. Errors do not end the thread.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.group = ThreadCallbackGroup()
        self._executor = GroupExecutor(node, self.group)
        self._is_ended = Event()
        self._thread = Thread(target=self._run, name='services', daemon=True)

    def start(self, on_failure: Callable[[Exception], None]) -> None:
        """Start the thread, which calls `on_failure` with each error of a service."""
        self._on_failure = on_failure
        self._thread.start()

    def close(self) -> None:
        """End the thread, and wait at most two seconds for the running service to return."""
        self._is_ended.set()
        self._executor.shutdown(timeout_sec=0.0)
        if self._thread.is_alive():
            self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        self.group.thread_id = get_ident()
        while not self._is_ended.is_set():
            try:
                self._executor.spin_once()
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - the next request must be served
                if not self._node.context.ok():
                    return
                self._on_failure(error)
                time.sleep(_PAUSE_S)
