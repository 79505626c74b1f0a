"""Work handed to a node's thread: done and answered, or given up and never done."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Thread
from typing import Any

import pytest

from hoid_common.errors import InputError
from rgbd_slam.ros.between_messages import BetweenMessages


class FakeNode:
    """A node of which the test says when it is between two messages."""

    def __init__(self) -> None:
        self.work: Callable[[], None] = lambda: None
        self.is_woken = Event()

    def create_guard_condition(self, callback: Callable[[], None]) -> FakeNode:
        self.work = callback
        return self

    def trigger(self) -> None:
        self.is_woken.set()


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


@pytest.fixture
def between(node: FakeNode, monkeypatch: pytest.MonkeyPatch) -> BetweenMessages:
    monkeypatch.setattr('rgbd_slam.ros.between_messages._LIMIT_S', 0.05)
    as_node: Any = node
    return BetweenMessages(as_node)


def test_what_is_given_up_does_not_happen_later(between: BetweenMessages, node: FakeNode) -> None:
    done: list[int] = []
    with pytest.raises(InputError, match='busy'):
        between.call(lambda: done.append(1))
    node.work()
    assert done == []


def test_what_is_under_way_at_the_limit_is_waited_for(
    between: BetweenMessages, node: FakeNode
) -> None:
    def act() -> str:
        caller.join(0.2)  # beyond the limit
        return 'done'

    answers: list[str] = []
    caller = Thread(target=lambda: answers.append(between.call(act)))
    caller.start()
    assert node.is_woken.wait(5.0)
    node.work()
    caller.join(5.0)
    assert answers == ['done']
