"""Functions called in a node's thread return their result, or time out and are never called."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Event, Thread
from typing import Any

import pytest

from hoid_common.errors import InputError
from rgbd_slam.ros.node_thread import NodeThread

LIMIT_S = 0.05


class FakeNode:
    """A node whose test decides when it runs the calls."""

    def __init__(self) -> None:
        self.run_calls: Callable[[], None] = lambda: None
        self.is_woken = Event()

    def create_guard_condition(self, callback: Callable[[], None]) -> FakeNode:
        self.run_calls = callback
        return self

    def trigger(self) -> None:
        self.is_woken.set()


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


@pytest.fixture
def thread(node: FakeNode, monkeypatch: pytest.MonkeyPatch) -> NodeThread:
    """A node thread whose limit is reached after 0.05 s."""
    result = Future.result
    monkeypatch.setattr(
        Future, 'result', lambda future, timeout=None: result(future, timeout and LIMIT_S)
    )
    as_node: Any = node
    return NodeThread(as_node)


def test_a_call_that_timed_out_is_never_made(thread: NodeThread, node: FakeNode) -> None:
    done: list[int] = []
    with pytest.raises(InputError, match='busy'):
        thread.call(lambda: done.append(1))
    node.run_calls()
    assert done == []


def test_a_call_that_has_started_is_awaited_beyond_the_limit(
    thread: NodeThread, node: FakeNode
) -> None:
    def function() -> str:
        caller.join(4 * LIMIT_S)
        return 'done'

    results: list[str] = []
    caller = Thread(target=lambda: results.append(thread.call(function)))
    caller.start()
    assert node.is_woken.wait(5.0)
    node.run_calls()
    caller.join(5.0)
    assert results == ['done']
