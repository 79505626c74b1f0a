"""Executors with low overhead for nodes whose subscriptions, timers and services rarely change.

For a message they take less than half of the processor time of rclpy's SingleThreadedExecutor.
rclpy's EventsExecutor hung in Jazzy (decision 015). While messages arrive, service requests and
QoS events are checked only 20 times a second, because adding all entities to a wait set takes as
long as some callbacks (decision 044).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from inspect import iscoroutine
from threading import RLock, get_ident
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor, TimeoutObject
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Task
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities

_Take = Callable[[Any], Any]
# Chosen: longest time until a service request or an event of the middleware is handled; people and
# lifecycle managers do not notice it.
_RARE_PERIOD_NS = 50_000_000


class _Held(NamedTuple):
    """An entity, such as a subscription, with the open handle that prevents its destruction."""

    entity: Any
    handle: Any
    pointer: int


class _WaitList:
    """An rclpy wait set of those entities of the nodes for which `is_served` returns True."""

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
        waitables = self._hold(entity for node in nodes for entity in node.waitables)
        # The waitables of a wait, without or with the rarely used ones.
        self._waitables = {
            True: waitables,
            False: [w for w in waitables if not isinstance(w, EventHandler)],
        }
        of_kind = {
            kind: self._hold(entity for node in nodes for entity in getattr(node, f'{name}s'))
            for kind, name in _NAMES.items()
        }
        of_kind['guard_condition'] += self._hold(guards)
        self._of_kind = {
            kind: [_Held(e, e.handle, e.handle.pointer) for e in entities]
            for kind, entities in of_kind.items()
            if entities
        }
        number = NumberOfEntities(*(len(of_kind[kind]) for kind in _COUNTED))
        for waitable in waitables:
            number += waitable.get_num_entities()
        self._wait_set = _rclpy.WaitSet(
            *(getattr(number, name) for name in NumberOfEntities.__slots__), context.handle
        )

    def close(self) -> None:
        """Release the entities, so that they can be destroyed."""
        self._wait_set = None
        self._held.close()

    def wait(self, limit_ns: int, *, with_rare: bool) -> None:
        """Wait until an entity is ready, at most `limit_ns` (-1 = no limit).

        Services and events of the middleware are included only if `with_rare`.
        """
        self._with_rare = with_rare
        self._wait_set.clear_entities()
        for kind, entities in self._of_kind.items():
            if with_rare or kind != _RARE:
                add = getattr(self._wait_set, f'add_{kind}')
                for entity in entities:
                    add(entity.handle)
        for waitable in self._waitables[with_rare]:
            waitable.add_to_wait_set(self._wait_set)
        self._wait_set.wait(limit_ns)

    def ready(self) -> Iterator[tuple[str, Any]]:
        """Yield kind and entity of each ready entity, in the order in which callbacks run."""
        for waitable in self._waitables[self._with_rare]:
            if waitable.is_ready(self._wait_set):
                yield 'waitable', waitable
        for kind, entities in self._of_kind.items():
            if not self._with_rare and kind == _RARE:
                continue
            if pointers := self._wait_set.get_ready_entities(kind):
                yield from ((kind, e.entity) for e in entities if e.pointer in pointers)

    def _hold(self, entities: Iterable[Any]) -> list[Any]:
        held = []
        for entity in entities:
            if not self._is_served(entity):
                continue
            try:
                self._held.enter_context(getattr(entity, 'handle', entity))
            except InvalidHandle:  # the entity is being destroyed
                continue
            held.append(entity)
        return held


# Kinds of entities. Each key is the name in rclpy's WaitSet (`add_<key>`); each value with an "s"
# appended is the attribute of a node that lists the entities. Callbacks of waitables run first,
# then those of the others in this order.
_NAMES = {
    'timer': 'timer',
    'subscription': 'subscription',
    'guard_condition': 'guard',
    'client': 'client',
    'service': 'service',
}
_RARE = 'service'
# Kinds in the order of the arguments of NumberOfEntities.
_COUNTED = ('subscription', 'guard_condition', 'timer', 'client', 'service')


class ThreadCallbackGroup(CallbackGroup):
    """Callback group of a node whose callbacks a `GroupExecutor` runs in a separate thread."""

    def __init__(self) -> None:
        super().__init__()
        self.thread_id: int | None = None  # id from threading.get_ident

    def can_execute(self, entity: Any) -> bool:
        del entity
        return get_ident() == self.thread_id

    def beginning_execution(self, entity: Any) -> bool:
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """Do nothing, since the thread runs one callback after the other."""


class SteadyExecutor(SingleThreadedExecutor):
    """A SingleThreadedExecutor that keeps its wait set while the nodes' entities stay the same.

    SingleThreadedExecutor builds a wait set before every callback, and wakes up once more after
    it. This class keeps the wait set until `wake` is called, as after a change of a node's
    entities, and runs all ready callbacks after each wait.
    """

    _rare_period_ns = _RARE_PERIOD_NS

    def __init__(self) -> None:
        super().__init__()
        self._list: _WaitList | None = None  # None: must be built
        self._rare_due_ns = 0  # time of the next wait that includes rare entities
        self._at_work = RLock()  # held while the wait set is used
        self._takes: Mapping[str, _Take] = {
            'waitable': self._take_waitable,
            'timer': self._take_period,
            'subscription': self._take_message,
            'guard_condition': self._take_guard_condition,
            'client': self._take_client,
            'service': self._take_service,
        }

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop the executor, and release all entities once the running callback has returned."""
        done = bool(super().shutdown(timeout_sec))
        if self._at_work.acquire(timeout=-1 if timeout_sec is None else timeout_sec):
            self._forget()
            self._at_work.release()
        return done

    def wake(self) -> None:
        """Wake the executor and drop its wait set, because the entities of a node have changed."""
        super().wake()
        if self._at_work.acquire(blocking=False):  # else the spinning thread drops the wait set
            self._forget()
            self._at_work.release()

    def spin_ready(self) -> bool:
        """Run all ready callbacks, one message per subscription; return whether a callback ran."""
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
        ready = self._wait(limit_ns)
        for take, entity in ready:
            self._run(take(entity))
        return bool(ready)

    def _run(self, act: Callable[[], Any] | None) -> None:
        """Run a callback that `_take_...` has returned, and raise its error."""
        if act is None or not iscoroutine(waiting := act()):
            return
        task = Task(waiting, executor=self)
        task()
        if not task.done():
            with self._tasks_lock:
                self._tasks.append((task, None, None))
        elif (error := task.exception()) is not None:
            raise error

    # They replace rclpy's `_take_subscription` and `_take_timer`, which create a coroutine and a
    # task for each call.
    def _take_message(self, sub: Any) -> Callable[[], Any] | None:
        try:
            with sub.handle:
                taken = sub.handle.take_message(sub.msg_type, sub.raw)
        except InvalidHandle:  # the entity is being destroyed
            return None
        if taken is None:
            return None
        is_alone = sub._callback_type is Subscription.CallbackType.MessageOnly  # noqa: SLF001
        return partial(sub.callback, *(taken[:1] if is_alone else taken))

    def _take_period(self, tmr: Any) -> Callable[[], Any] | None:
        try:
            with tmr.handle:
                tmr.handle.call_timer()
        except InvalidHandle:  # the entity is being destroyed
            return None
        callback: Callable[[], Any] = tmr.callback
        return callback

    def _wait(self, limit_ns: int) -> list[tuple[_Take, Any]]:
        """Return the entities that are ready within `limit_ns` (-1: no limit), with their methods.

        Nothing is returned if the executor was woken or shut down. ExternalShutdownException if
        ROS was shut down.
        """
        own = (self._guard, self._sigint_gc)
        if self._list is None:
            self._list = _WaitList(self.get_nodes(), self._context, own, self._serves)
        try:
            found = self._wait_for_entities(self._list, limit_ns)
        except InvalidHandle:  # the owner of an event is being destroyed
            self._forget()
            return []
        if self._is_shutdown:
            return []
        if not self._context.ok():
            raise ExternalShutdownException
        if any(entity is self._guard for _, entity in found):
            self._forget()  # a node's entities have changed
        return [(take, entity) for take, entity in found if entity not in own]

    def _wait_for_entities(self, entities: _WaitList, limit_ns: int) -> list[tuple[_Take, Any]]:
        """Wait for all but the rare entities until the rare ones are due, then for all."""
        now_ns = time.monotonic_ns()
        if (left_ns := self._rare_due_ns - now_ns) > 0:
            first_ns = left_ns if limit_ns < 0 else min(left_ns, limit_ns)
            entities.wait(first_ns, with_rare=False)
            found = self._ready(entities)
            is_ended = self._is_shutdown or not self._context.ok()
            if found or is_ended or 0 <= limit_ns <= left_ns:
                return found
            limit_ns = limit_ns if limit_ns < 0 else limit_ns - left_ns
        entities.wait(limit_ns, with_rare=True)
        found = self._ready(entities)
        self._rare_due_ns = time.monotonic_ns() + self._rare_period_ns
        return found

    def _ready(self, entities: _WaitList) -> list[tuple[_Take, Any]]:
        return [(self._takes[kind], entity) for kind, entity in entities.ready()]

    def _serves(self, entity: Any) -> bool:
        return not isinstance(getattr(entity, 'callback_group', None), ThreadCallbackGroup)

    def _forget(self) -> None:
        """Release the wait set; the next wait builds a new one that includes rare entities."""
        if self._list is not None:
            self._list.close()
        self._list = None
        self._rare_due_ns = 0


class GroupExecutor(SteadyExecutor):
    """Runs the services of one callback group; create them before the executor spins."""

    _rare_period_ns = 0  # it always waits for services, its only entities

    def __init__(self, node: Node, group: ThreadCallbackGroup) -> None:
        super().__init__()
        self._node, self._group = node, group

    def get_nodes(self) -> list[Node]:
        return [self._node]

    def _serves(self, entity: Any) -> bool:
        is_own = entity in (self._guard, self._sigint_gc)
        return is_own or getattr(entity, 'callback_group', None) is self._group
