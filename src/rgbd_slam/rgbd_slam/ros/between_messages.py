"""Work that other threads have done in a node's own thread, between two messages."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import TypeVar

from rclpy.node import Node

from hoid_common.errors import InputError

T = TypeVar('T')

_LIMIT_S = 60.0


class BetweenMessages:
    """Runs what other threads hand over in the thread that spins the node."""

    def __init__(self, node: Node) -> None:
        self._waiting: SimpleQueue[tuple[Callable[[], object], Future[object]]] = SimpleQueue()
        self._wake = node.create_guard_condition(self._work)

    def call(self, act: Callable[[], T]) -> T:
        """Return what an act returns, or raise what it raises.

        Raises:
            InputError: The node does not get round to it, and will not do it later either.
        """
        done: Future[object] = Future()
        self._waiting.put((act, done))
        self._wake.trigger()
        try:
            return done.result(_LIMIT_S)  # type: ignore[return-value]  # it is the act's
        except TimeoutError:
            if not done.cancel():  # the node is at it: its outcome is the answer
                return done.result()  # type: ignore[return-value]
            raise InputError(f'the node has been busy for {_LIMIT_S:g} s; try again') from None

    def _work(self) -> None:
        while not self._waiting.empty():
            act, done = self._waiting.get()
            if not done.set_running_or_notify_cancel():
                continue
            try:
                done.set_result(act())
            except Exception as error:  # noqa: BLE001 - it is for the thread that asked
                done.set_exception(error)
