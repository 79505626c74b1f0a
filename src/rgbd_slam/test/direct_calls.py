"""A stand-in of the node's thread, for tests without a node."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rgbd_slam.ros.node_thread import NodeThread

T = TypeVar('T')


class DirectCalls(NodeThread):
    """Calls functions in the thread that asks for it."""

    def __init__(self, _: object) -> None:
        pass

    def call(self, function: Callable[[], T]) -> T:
        return function()
