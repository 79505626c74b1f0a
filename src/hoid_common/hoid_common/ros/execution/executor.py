"""An executor for nodes whose subscriptions, timers and services seldom change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from threading import RLock, get_ident
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor, TimeoutObject
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.task import Task
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities

_Take = Callable[[Any], Any]


class _WaitList:
    """The entities of nodes in a wait set; they are not destroyed while it is open."""

    def __init__(
        self,
        nodes: Iterable[Node],
        context: Context,
        guards: Iterable[Any],
        is_served: Callable[[Any], bool],
    ) -> None:
        self._held = ExitStack()
        self._held.enter_context(context.handle)
        self._is_served = is_served
        self.waitables = self._hold(entity for node in nodes for entity in node.waitables)
        self.of_kind: dict[str, list[Any]] = {
            kind: self._hold(entity for node in nodes for entity in getattr(node, f'{name}s'))
            for kind, name in _NAMES.items()
        }
        self.of_kind['guard_condition'] += self._hold(guards)
        number = NumberOfEntities(*map(len, (self.of_kind[kind] for kind in _COUNTED)))
        for waitable in self.waitables:
            number += waitable.get_num_entities()
        self._wait_set = _rclpy.WaitSet(
            *(getattr(number, name) for name in NumberOfEntities.__slots__), context.handle
        )

    def close(self) -> None:
        """Let the entities go."""
        self._wait_set = None
        self._held.close()

    def wait(self, limit_ns: int) -> None:
        """Wait until something is ready, or for so long; -1 is for ever."""
        self._wait_set.clear_entities()
        for kind, entities in self.of_kind.items():
            add = getattr(self._wait_set, f'add_{kind}')
            for entity in entities:
                add(entity.handle)
        for waitable in self.waitables:
            waitable.add_to_wait_set(self._wait_set)
        self._wait_set.wait(limit_ns)

    def ready(self, kind: str) -> list[Any]:
        """Return what of a kind has become ready."""
        pointers = self._wait_set.get_ready_entities(kind)
        return [e for e in self.of_kind[kind] if e.handle.pointer in pointers] if pointers else []

    def ready_waitables(self) -> list[Any]:
        """Return the waitables that have become ready."""
        return [waitable for waitable in self.waitables if waitable.is_ready(self._wait_set)]

    def _hold(self, entities: Iterable[Any]) -> list[Any]:
        held = []
        for entity in entities:
            if not self._is_served(entity):
                continue
            try:
                self._held.enter_context(getattr(entity, 'handle', entity))
            except InvalidHandle:  # it is being destroyed
                continue
            held.append(entity)
        return held


# Kinds in order of service, and what a node calls them.
_NAMES = {
    'timer': 'timer',
    'subscription': 'subscription',
    'guard_condition': 'guard',
    'client': 'client',
    'service': 'service',
}
_COUNTED = ('subscription', 'guard_condition', 'timer', 'client', 'service')


class ThreadCallbackGroup(CallbackGroup):
    """Callbacks of a node that a thread of their own runs, with a `GroupExecutor`."""

    def __init__(self) -> None:
        super().__init__()
        self.thread_id: int | None = None  # as of threading.get_ident

    def can_execute(self, entity: Any) -> bool:
        """Return whether this thread is the one: other executors leave the callbacks alone."""
        del entity
        return get_ident() == self.thread_id

    def beginning_execution(self, entity: Any) -> bool:
        """Return the same."""
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: the thread runs one callback after the other."""


class SteadyExecutor(SingleThreadedExecutor):
    """A SingleThreadedExecutor that asks what there is to wait for only when that has changed.

    Before every callback its base goes through all entities of all nodes and builds a wait set,
    and after it wakes itself to do so once more, which costs more than the callbacks of most
    messages. This one keeps the wait set until a node says that its entities have changed, and
    runs all that has become ready. Callbacks that await a future are left to the base.
    """

    def __init__(self) -> None:
        super().__init__()
        self._list: _WaitList | None = None  # None = to be gathered
        self._at_work = RLock()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop; the nodes can be destroyed afterwards, or when a callback that runs is done."""
        done = bool(super().shutdown(timeout_sec))
        if self._at_work.acquire(timeout=-1 if timeout_sec is None else timeout_sec):
            self._forget()
            self._at_work.release()
        return done

    def wake(self) -> None:
        """Gather anew, as what a node has changed; what it destroyed is let go at once."""
        super().wake()
        if self._at_work.acquire(blocking=False):  # otherwise who spins lets go
            self._forget()
            self._at_work.release()

    def spin_ready(self) -> bool:
        """Run what is ready, one message of each subscription, and return whether there was any.

        It does not wait, and callbacks that await a future go on only when it is spun otherwise.
        """
        with self._at_work:
            return not self._is_shutdown and self._run_ready(0)

    def _spin_once_impl(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        wait_condition: Callable[[], bool] = lambda: False,
    ) -> None:
        if self._tasks:
            super()._spin_once_impl(timeout_sec, wait_condition)
            return
        limit_s = timeout_sec.timeout if isinstance(timeout_sec, TimeoutObject) else timeout_sec
        with self._at_work:
            if not self._is_shutdown and not wait_condition():
                self._run_ready(timeout_sec_to_nsec(limit_s))
            if self._is_shutdown:
                self._forget()

    def _run_ready(self, limit_ns: int) -> bool:
        """Run what becomes ready within some time, -1 being for ever; return whether any did."""
        ready = self._wait(limit_ns)
        for take, entity in ready:
            self._run(take(entity))
        return bool(ready)

    def _run(self, act: Callable[[], Any] | None) -> None:
        """Run what one of the base's `_take_...` returned."""
        if act is None:
            return
        task = Task(act, executor=self)
        task()
        if not task.done():
            with self._tasks_lock:
                self._tasks.append((task, None, None))
        elif (error := task.exception()) is not None:
            raise error

    def _wait(self, limit_ns: int) -> list[tuple[_Take, Any]]:
        """Return what became ready, each with the function of the base that takes it."""
        if self._list is None:
            own = (self._guard, self._sigint_gc)
            self._list = _WaitList(self.get_nodes(), self._context, own, self._serves)
        try:
            self._list.wait(limit_ns)
        except InvalidHandle:  # of an event whose owner is being destroyed
            self._forget()
            return []
        if self._is_shutdown:
            return []
        if not self._context.ok():
            raise ExternalShutdownException
        ready = list(self._ready(self._list))
        if any(entity is self._guard for _, entity in ready):
            self._forget()  # a node has changed
        own = (self._guard, self._sigint_gc)
        return [(take, entity) for take, entity in ready if entity not in own]

    def _ready(self, found: _WaitList) -> Iterator[tuple[_Take, Any]]:
        yield from ((self._take_waitable, waitable) for waitable in found.ready_waitables())
        takes = {
            'timer': self._take_timer,
            'subscription': self._take_subscription,
            'guard_condition': self._take_guard_condition,
            'client': self._take_client,
            'service': self._take_service,
        }
        for kind, take in takes.items():
            yield from ((take, entity) for entity in found.ready(kind))

    def _serves(self, entity: Any) -> bool:
        """Return whether an entity's callbacks are for this executor."""
        return not isinstance(getattr(entity, 'callback_group', None), ThreadCallbackGroup)

    def _forget(self) -> None:
        if self._list is not None:
            self._list.close()
            self._list = None


class GroupExecutor(SteadyExecutor):
    """Runs the callbacks of one group of a node, whose others an executor in another thread runs.

    Args:
        node: The node, which stays with its own executor.
        group: Whose callbacks these are; all made before this.
    """

    def __init__(self, node: Node, group: ThreadCallbackGroup) -> None:
        super().__init__()
        self._node, self._group = node, group

    def get_nodes(self) -> list[Node]:
        """Return the node."""
        return [self._node]

    def _serves(self, entity: Any) -> bool:
        is_own = entity in (self._guard, self._sigint_gc)
        return is_own or getattr(entity, 'callback_group', None) is self._group
