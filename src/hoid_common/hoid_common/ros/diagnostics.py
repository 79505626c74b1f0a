"""What a node says about itself on /diagnostics, in plain words."""

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
from hoid_common.ros import qos
from hoid_common.throttle import Backoff, Throttle

_PERIOD_S = 1.0
_LOG_PERIOD_S = 5.0
_LONGEST_WAIT_S = 300.0  # between two lines on an input that stays away


class _Problem(NamedTuple):
    level: bytes  # of diagnostic_msgs/DiagnosticStatus
    text: str


class Diagnostics:
    """Counts, values, missing inputs and errors of a node, published once a second (wall time).

    The level is WARN while an input is missing or a problem stands, ERROR while a severe one
    stands, else OK.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._watches: list[InputWatch] = []
        self._counts: Counter[str] = Counter()
        self._values: dict[str, str] = {}
        self._problems: dict[str, _Problem] = {}
        self._throttle = Throttle(_LOG_PERIOD_S)
        self._backoff = Backoff(_LOG_PERIOD_S, _LONGEST_WAIT_S)
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.OUTPUT)
        # Wall time: with use_sim_time and no /clock, a ROS timer would never fire to say so.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD_S, self._publish, clock=steady)

    def watch(
        self, topic: str, what: str, reliability: str, *, is_occasional: bool = False
    ) -> InputWatch:
        """Report the input when it is silent; `heard()` of the result is to be called per message.

        Args:
            topic: its full name.
            what: what the messages are, in the plural, such as "depth images".
            reliability: what the subscription asks for.
            is_occasional: Whether it is only counted, as it is silent most of the time.
        """
        watch = InputWatch(what, topic, reliability, time.monotonic(), is_occasional)
        self._watches.append(watch)
        return watch

    def count(self, name: str, number: int = 1) -> None:
        """Add to a counter."""
        self._counts[name] += number

    def set_count(self, name: str, number: int) -> None:
        """Set a counter that is kept elsewhere."""
        self._counts[name] = number

    def set_value(self, name: str, value: str) -> None:
        """Say something that is no counter."""
        self._values[name] = value

    def set_problem(self, name: str, text: str, *, severe: bool = False) -> None:
        """Let a problem stand until `clear_problem`; it is logged when it is new."""
        level = DiagnosticStatus.ERROR if severe else DiagnosticStatus.WARN
        if name not in self._problems:
            self._node.get_logger().warning(text)
        self._problems[name] = _Problem(level, text)

    def clear_problem(self, name: str) -> None:
        """Take a problem back."""
        self._problems.pop(name, None)

    def report(self, error: HoidError, what: str = 'messages refused') -> None:
        """Count an error and log it, at most once in a while per kind."""
        self.count(what)
        kind = f'{what}: {str(error).split(maxsplit=1)[0]}'
        held_back = self._throttle.allow(kind, time.monotonic())
        if held_back is not None:
            more = f' ({held_back} more of the kind)' if held_back else ''
            self._node.get_logger().error(f'{error}{more}')

    def status(self) -> DiagnosticStatus:
        """Return what is published now."""
        return self._status(self._input_problems())

    def _status(self, input_problems: list[_Problem]) -> DiagnosticStatus:
        problems = [*self._problems.values(), *input_problems]
        level = max((level for level, _ in problems), default=DiagnosticStatus.OK)
        received = {f'{w.what} received': w.num_received for w in self._watches}
        lost = {f'{w.what} lost': w.num_lost for w in self._watches}
        counts = received | lost | self._counts  # a copy: other threads count as well
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
            watch.complaint(now_s, self._offered(watch.topic))
            for watch in self._watches
            if watch.is_missing(now_s)
        ]
        texts += [watch.loss(now_s) for watch in self._watches if watch.is_losing(now_s)]
        clock = self._node.get_clock()
        if clock.ros_time_is_active and clock.now().nanoseconds == 0:
            texts.append('use_sim_time is set, but no time came on /clock')
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
