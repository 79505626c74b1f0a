"""A node's status on /diagnostics: counters, values, missing inputs and errors.

diagnostic_updater has a similar interface, but is missing from the wheels of rclpy.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import HoidError
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.log_throttle import Backoff, LogThrottle
from hoid_common.ros import qos

_PERIOD_S = 1.0  # of the messages; diagnostic_updater's default
_LOG_PERIOD_S = 5.0  # chosen: shortest time between two log lines of the same kind
_MAX_LOG_PERIOD_S = 300.0  # chosen: longest time between two log lines about a missing input


class _Problem(NamedTuple):
    level: bytes  # of diagnostic_msgs/DiagnosticStatus
    text: str


class Diagnostics:
    """Publishes the status of a node once a second.

    The level is ERROR while a severe problem exists, WARN while another problem exists or an input
    is missing, and OK otherwise.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._watches: list[InputWatch] = []
        self._counts: Counter[str] = Counter()
        self._values: dict[str, str] = {}
        self._problems: dict[str, _Problem] = {}
        self._throttle = LogThrottle(_LOG_PERIOD_S)
        self._backoff = Backoff(_LOG_PERIOD_S, _MAX_LOG_PERIOD_S)
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.OUTPUT)
        # Not ROS time: with use_sim_time and no /clock, the timer would never report that.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD_S, self._publish, clock=steady)

    def watch(
        self, topic: str, what: str, reliability: str, *, is_occasional: bool = False
    ) -> InputWatch:
        """Return a watch of an input, which is reported while its messages are missing or lost.

        The subscription calls `record_message` of the watch for each message.

        Args:
            topic: Full name of the topic.
            what: The messages in the plural, such as "depth images".
            reliability: What the subscription requests.
            is_occasional: Whether silence is normal, so that messages are only counted.
        """
        watch = InputWatch(what, topic, reliability, time.monotonic(), is_occasional)
        self._watches.append(watch)
        return watch

    def count(self, name: str, number: int = 1) -> None:
        """Add a number to a counter."""
        self._counts[name] += number

    def set_count(self, name: str, number: int) -> None:
        """Set a counter to a number that is counted elsewhere."""
        self._counts[name] = number

    def set_value(self, name: str, value: str) -> None:
        """Set a value that is no counter, such as the name of a model."""
        self._values[name] = value

    def set_problem(self, name: str, text: str, *, severe: bool = False) -> None:
        """Report a problem until `clear_problem` is called; a new problem is logged once."""
        level = DiagnosticStatus.ERROR if severe else DiagnosticStatus.WARN
        if name not in self._problems:
            self._node.get_logger().warning(text)
        self._problems[name] = _Problem(level, text)

    def clear_problem(self, name: str) -> None:
        """Stop reporting a problem, if it exists."""
        self._problems.pop(name, None)

    def report(self, error: HoidError, what: str = 'messages refused') -> None:
        """Count an error, and log it at most once in five seconds per kind.

        Args:
            error: Errors whose text begins with the same word are of the same kind.
            what: Name of the counter.
        """
        self.count(what)
        kind = f'{what}: {str(error).split(maxsplit=1)[0]}'
        num_suppressed = self._throttle.allow(kind, time.monotonic())
        if num_suppressed is not None:
            more = f' ({num_suppressed} similar errors not shown)' if num_suppressed else ''
            self._node.get_logger().error(f'{error}{more}')

    def status(self) -> DiagnosticStatus:
        """Return the status as it would be published now."""
        return self._status(self._input_problems())

    def _status(self, input_problems: list[_Problem]) -> DiagnosticStatus:
        problems = [*self._problems.values(), *input_problems]
        level = max((level for level, _ in problems), default=DiagnosticStatus.OK)
        received = {f'{w.what} received': w.num_received for w in self._watches}
        lost = {f'{w.what} lost': w.num_lost for w in self._watches}
        counts = received | lost | self._counts  # a copy, since other threads count as well
        texts = self._values | {key: str(number) for key, number in counts.items()}
        return DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message='; '.join(text for _, text in problems) or 'running',
            values=[KeyValue(key=key, value=value) for key, value in texts.items()],
        )

    def _input_problems(self) -> list[_Problem]:
        now_s = time.monotonic()
        texts = [
            watch.missing_message(now_s, self._offered(watch.topic))
            for watch in self._watches
            if watch.is_missing(now_s)
        ]
        texts += [watch.loss_message(now_s) for watch in self._watches if watch.is_losing(now_s)]
        clock = self._node.get_clock()
        if clock.ros_time_is_active and clock.now().nanoseconds == 0:
            texts.append('use_sim_time is set, but no message was received on /clock')
        return [_Problem(DiagnosticStatus.WARN, text) for text in texts]

    def _offered(self, topic: str) -> list[str]:
        infos = self._node.get_publishers_info_by_topic(topic)
        return [info.qos_profile.reliability.name.lower() for info in infos]

    def _publish(self) -> None:
        problems = self._input_problems()
        msg = DiagnosticArray(status=[self._status(problems)])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        texts = {text.split(' for ')[0]: text for _, text in problems}
        for kind in self._backoff.due(texts, time.monotonic()):
            self._node.get_logger().warning(texts[kind])
        self._publisher.publish(msg)
