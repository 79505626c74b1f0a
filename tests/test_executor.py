"""`SteadyExecutor` serves all entities that the executors of rclpy serve."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.ros.execution.service_thread import ServiceThread

_LIMIT_S = 20.0


@pytest.fixture
def node(domain_id: int) -> Iterator[Node]:
    rclpy.init(domain_id=domain_id)
    node = Node('probe')
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def executor(node: Node) -> Iterator[SteadyExecutor]:
    executor = SteadyExecutor()
    executor.add_node(node)
    yield executor
    executor.shutdown()


def spin_until(executor: SteadyExecutor, is_done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + _LIMIT_S
    while not is_done():
        assert time.monotonic() < end_s
        executor.spin_once(timeout_sec=0.1)


def test_messages_arrive_in_order_without_loss(node: Node, executor: SteadyExecutor) -> None:
    received: list[str] = []
    node.create_subscription(Header, 'words', lambda msg: received.append(msg.frame_id), 100)
    publisher = node.create_publisher(Header, 'words', 100)
    spin_until(executor, lambda: publisher.get_subscription_count() == 1)
    sent = [f'word {k}' for k in range(50)]
    for word in sent:
        publisher.publish(Header(frame_id=word))
    spin_until(executor, lambda: len(received) >= len(sent))
    assert received == sent


def test_spin_ready_runs_ready_callbacks_without_waiting(
    node: Node, executor: SteadyExecutor
) -> None:
    received: list[str] = []
    node.create_subscription(Header, 'words', lambda msg: received.append(msg.frame_id), 100)
    publisher = node.create_publisher(Header, 'words', 100)
    spin_until(executor, lambda: publisher.get_subscription_count() == 1)
    start_s = time.monotonic()
    while executor.spin_ready():  # callbacks that the discovery has woken
        assert time.monotonic() < start_s + _LIMIT_S
    sent = [f'word {k}' for k in range(50)]
    for word in sent:
        publisher.publish(Header(frame_id=word))
    while len(received) < len(sent):
        before = len(received)
        assert executor.spin_ready() or len(received) == before
        assert time.monotonic() < start_s + _LIMIT_S
    assert received == sent
    executor.shutdown()
    assert not executor.spin_ready()


def test_timers_guards_services_and_clients_are_served(
    node: Node, executor: SteadyExecutor
) -> None:
    called: list[str] = []
    timer = node.create_timer(0.01, lambda: called.append('timer'))
    guard = node.create_guard_condition(lambda: called.append('guard'))

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.message = f'received {request.data}'
        return response

    node.create_service(SetBool, 'switch', answer)
    client = node.create_client(SetBool, 'switch')
    spin_until(executor, client.service_is_ready)
    future: Future = client.call_async(SetBool.Request(data=True))
    guard.trigger()
    executor.spin_until_future_complete(future, _LIMIT_S)
    assert future.result().message == 'received True'
    spin_until(executor, lambda: called.count('timer') >= 3 and 'guard' in called)
    assert called.count('guard') == 1
    timer.cancel()
    called.clear()
    executor.spin_once(timeout_sec=0.05)
    assert not called


def test_subscriptions_made_or_destroyed_while_spinning_take_effect_at_once(
    node: Node, executor: SteadyExecutor
) -> None:
    has_received = threading.Event()
    publisher = node.create_publisher(Header, 'late', 10)
    executor.spin_once(timeout_sec=0.01)
    thread = threading.Thread(target=spin_until, args=(executor, has_received.is_set))
    thread.start()
    subscription = node.create_subscription(Header, 'late', lambda _: has_received.set(), 10)
    end_s = time.monotonic() + _LIMIT_S
    while not has_received.wait(0.02) and time.monotonic() < end_s:
        publisher.publish(Header())
    thread.join()
    assert has_received.is_set()
    node.destroy_subscription(subscription)
    executor.spin_once(timeout_sec=0.01)
    spin_until(executor, lambda: publisher.get_subscription_count() == 0)


def test_a_node_can_be_destroyed_between_two_spins(node: Node, executor: SteadyExecutor) -> None:
    publisher = node.create_publisher(Header, 'gone', 10)
    other = Node('other')
    other.create_subscription(Header, 'gone', lambda _: None, 10)
    of_other = SteadyExecutor()
    of_other.add_node(other)
    spin_until(of_other, lambda: publisher.get_subscription_count() == 1)
    for _ in range(5):  # until nothing changes any more and the wait set is kept
        of_other.spin_once(timeout_sec=0.01)
    other.destroy_node()
    spin_until(executor, lambda: publisher.get_subscription_count() == 0)


def test_callbacks_may_await_futures(node: Node, executor: SteadyExecutor) -> None:
    node.create_service(SetBool, 'echo', lambda _, response: response)
    client = node.create_client(SetBool, 'echo')
    answers: list[object] = []

    async def ask() -> None:
        timer.cancel()
        answers.append(await client.call_async(SetBool.Request()))

    spin_until(executor, client.service_is_ready)
    timer = node.create_timer(0.01, ask)
    spin_until(executor, lambda: bool(answers))
    assert isinstance(answers[0], SetBool.Response)


def test_exceptions_of_callbacks_reach_the_caller_of_spin(
    node: Node, executor: SteadyExecutor
) -> None:
    def fail() -> None:
        raise KeyError('a bug')

    node.create_timer(0.01, fail)
    with pytest.raises(KeyError, match='a bug'):
        spin_until(executor, lambda: False)


def test_spinning_ends_with_the_context(node: Node, executor: SteadyExecutor) -> None:
    context: Context = node.context
    threading.Timer(0.2, context.try_shutdown).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()


def test_spinning_ends_with_the_context_just_after_a_message(
    node: Node, executor: SteadyExecutor
) -> None:
    """Requests and events are not waited for then, but the end of the context is."""
    received: list[Header] = []
    node.create_subscription(Header, 'words', received.append, 10)
    publisher = node.create_publisher(Header, 'words', 10)
    spin_until(executor, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Header())
    spin_until(executor, lambda: len(received) == 1)
    ending = threading.Timer(0.02, rclpy.try_shutdown)
    ending.start()
    # RuntimeError: this thread was so late that the context had ended before.
    with pytest.raises((ExternalShutdownException, RuntimeError)):
        executor.spin_once()
    ending.join()


def test_requests_are_served_while_messages_arrive(node: Node, executor: SteadyExecutor) -> None:
    received: list[Header] = []
    node.create_subscription(Header, 'words', received.append, 10)
    publisher = node.create_publisher(Header, 'words', 10)
    node.create_service(SetBool, 'enable', lambda _, response: response)
    client = node.create_client(SetBool, 'enable')
    spin_until(executor, client.service_is_ready)
    node.create_timer(1e-3, lambda: publisher.publish(Header()))
    spin_until(executor, lambda: len(received) > 10)
    future = client.call_async(SetBool.Request())
    sent = len(received)
    spin_until(executor, future.done)
    assert len(received) - sent < 1000  # of 20 in the longest time for which a request waits


def test_a_service_thread_answers_while_the_node_is_busy(
    node: Node, executor: SteadyExecutor
) -> None:
    """The node's executor does not serve them, and an exception does not end the thread."""
    failures: list[Exception] = []
    answering: list[int] = []
    thread = ServiceThread(node)

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            raise KeyError('a bug')
        answering.append(threading.get_ident())
        response.success = True
        return response

    node.create_service(SetBool, 'apart', answer, callback_group=thread.group)
    thread.start(failures.append)
    asking = Node('asking')
    client = asking.create_client(SetBool, 'apart')
    elsewhere = SteadyExecutor()
    elsewhere.add_node(asking)
    spin_until(elsewhere, client.service_is_ready)
    try:
        for data in (True, False, False, True):  # this thread spins the client only
            future: Future = client.call_async(SetBool.Request(data=data))
            if data:
                elsewhere.spin_until_future_complete(future, _LIMIT_S)
        spin_until(elsewhere, lambda: len(failures) == 2)
        assert future.result().success
        assert [str(error) for error in failures] == ["'a bug'"] * 2
        for _ in range(3):
            client.call_async(SetBool.Request(data=True))
            executor.spin_once(timeout_sec=0.1)
        spin_until(elsewhere, lambda: len(answering) == 5)
        assert threading.get_ident() not in answering
    finally:
        thread.close()
        elsewhere.shutdown()
        asking.destroy_node()
