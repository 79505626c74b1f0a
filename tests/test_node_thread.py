"""Functions called in a node's thread return their result, or time out and are never called."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Event, Thread
from typing import Any

import pytest

from hoid_common.errors import InputError
from rgbd_slam.ros.node_thread import NodeThread


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


class Limit:
    """A limit of time that a test decides, in place of the one that `Future.result` is given."""

    def __init__(self) -> None:
        self.is_reached = Event()
        self.is_exceeded = Event()  # the caller waits on, without a limit
        self._result = Future.result

    def result(self, future: Future[object], timeout: float | None = None) -> object:
        if timeout is None:
            self.is_exceeded.set()
            return self._result(future)
        assert self.is_reached.wait(30.0)
        return self._result(future, 0.0)


@pytest.fixture
def limit(monkeypatch: pytest.MonkeyPatch) -> Limit:
    limit = Limit()
    result = limit.result
    monkeypatch.setattr(Future, 'result', lambda future, timeout=None: result(future, timeout))
    return limit


@pytest.fixture
def thread(node: FakeNode) -> NodeThread:
    as_node: Any = node
    return NodeThread(as_node)


def test_a_call_that_timed_out_is_never_made(
    thread: NodeThread, node: FakeNode, limit: Limit
) -> None:
    limit.is_reached.set()
    done: list[int] = []
    with pytest.raises(InputError, match='busy'):
        thread.call(lambda: done.append(1))
    node.run_calls()
    assert done == []


def test_a_call_that_has_started_is_awaited_beyond_the_limit(
    thread: NodeThread, node: FakeNode, limit: Limit
) -> None:
    def function() -> str:
        limit.is_reached.set()
        assert limit.is_exceeded.wait(30.0)
        return 'done'

    results: list[str] = []
    caller = Thread(target=lambda: results.append(thread.call(function)))
    caller.start()
    assert node.is_woken.wait(30.0)
    node.run_calls()
    caller.join(30.0)
    assert results == ['done']
