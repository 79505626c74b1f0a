"""Functions called in a node's thread return their result, or are given up and never called."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Thread
from typing import Any

import pytest

from hoid_common.errors import InputError
from rgbd_slam.ros.node_thread import NodeThread


class FakeNode:
    """A node whose test decides when it is between two messages."""

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
    monkeypatch.setattr('rgbd_slam.ros.node_thread._LIMIT_S', 0.05)
    as_node: Any = node
    return NodeThread(as_node)


def test_a_call_that_is_given_up_is_never_made(thread: NodeThread, node: FakeNode) -> None:
    done: list[int] = []
    with pytest.raises(InputError, match='busy'):
        thread.call(lambda: done.append(1))
    node.run_calls()
    assert done == []


def test_a_call_that_has_begun_is_waited_for_beyond_the_limit(
    thread: NodeThread, node: FakeNode
) -> None:
    def function() -> str:
        caller.join(0.2)  # beyond the limit
        return 'done'

    results: list[str] = []
    caller = Thread(target=lambda: results.append(thread.call(function)))
    caller.start()
    assert node.is_woken.wait(5.0)
    node.run_calls()
    caller.join(5.0)
    assert results == ['done']
