"""Calls of functions in the thread that spins the node, requested by other threads."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import TypeVar

from rclpy.node import Node

from hoid_common.errors import InputError

T = TypeVar('T')

_LIMIT_S = 60.0  # chosen: the time limit of the mapping process for one request
# Chosen: pause between two calls of a polled function, in which tracking continues.
_POLL_S = 0.05


class NodeThread:
    """Calls functions for other threads in the thread that spins the node, between messages."""

    def __init__(self, node: Node) -> None:
        self._calls: SimpleQueue[tuple[Callable[[], object], Future[object]]] = SimpleQueue()
        self._wake = node.create_guard_condition(self._run_calls)

    def call(self, function: Callable[[], T]) -> T:
        """Call a function in the node's thread, and return its result.

        Do not use this in the node's thread, which would wait for itself.

        Raises:
            InputError: The node was busy for 60 s; the function is not called any more.
        """
        done: Future[object] = Future()
        self._calls.put((function, done))
        self._wake.trigger()
        try:
            return done.result(_LIMIT_S)  # type: ignore[return-value]  # it is the function's
        except TimeoutError:
            if not done.cancel():  # the call has begun: wait for its result
                return done.result()  # type: ignore[return-value]
            raise InputError(f'the node has been busy for {_LIMIT_S:g} s; try again') from None

    def poll(self, function: Callable[[], bool], end_s: float) -> bool:
        """Call a function until it returns True or `end_s` has passed; return its last value."""
        while not (value := self.call(function)) and time.monotonic() < end_s:
            time.sleep(_POLL_S)
        return value

    def _run_calls(self) -> None:
        while not self._calls.empty():
            function, done = self._calls.get()
            if not done.set_running_or_notify_cancel():
                continue
            try:
                done.set_result(function())
            except Exception as error:  # noqa: BLE001 - it is raised in the calling thread
                done.set_exception(error)
