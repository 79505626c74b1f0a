"""Publishing of a node's status on /diagnostics: counters, values, missing inputs and errors.

diagnostic_updater has a similar interface, but the pip wheels of rclpy lack it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from ament_index_python import PackageNotFoundError, get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import HoidError
from hoid_common.inputs.input_watch import InputLog, InputWatch
from hoid_common.log_throttle import Backoff, LogThrottle
from hoid_common.process.shared_memory import full_profile, uses_fast_dds
from hoid_common.ros import qos

_PERIOD_S = 1.0  # between two messages; diagnostic_updater's default
_LOG_PERIOD_S = 5.0  # chosen: shortest time between two log lines of the same kind
_MAX_LOG_PERIOD_S = 300.0  # chosen: longest time between two log lines about one problem
# Chosen: longer than the 20 s after which a killed node disappears from the ROS graph (the lease
# duration in the suite's Fast DDS profile).
_NAMESAKE_S = 25.0
_NAMESAKE = 'namesake'  # name of the problem that two nodes have the same name
_FILTER = 'hoid_filter'
_SUITE = ('hoid_detector', _FILTER, 'rgbd_slam')  # names of nodes, which a remap may change


class _Problem(NamedTuple):
    level: bytes  # level of diagnostic_msgs/DiagnosticStatus
    text: str


class Diagnostics:
    """Publishes the status of a node once a second.

    The level is ERROR while a severe problem exists, WARN while another one exists, an input is
    missing or loses messages, or simulated time has not begun, and OK otherwise.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._watches: list[InputWatch] = []
        self._counts: Counter[str] = Counter()
        self._values: dict[str, str] = {}
        self._problems: dict[str, _Problem] = {}
        self._throttle = LogThrottle(_LOG_PERIOD_S)
        self._backoffs: dict[str, Backoff] = {}  # by name of the problem
        self._input_log = InputLog(node.get_logger(), self._is_cause, time.monotonic())
        self._profile = _transport_profile()
        self._alone_s = time.monotonic()  # last time with no other node of this name
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.OUTPUT)
        # The timer uses steady time. With use_sim_time and no /clock, a timer of ROS time would
        # never run, so that the missing /clock would not be reported.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD_S, self._publish, clock=steady)

    def watch(
        self,
        topic: str,
        what: str,
        reliability: str,
        *,
        is_occasional: bool = False,
        is_latched: bool = False,
    ) -> InputWatch:
        """Report missing and lost messages of a topic; the caller records them in the result."""
        watch = InputWatch(what, topic, reliability, time.monotonic(), is_occasional, is_latched)
        self._watches.append(watch)
        return watch

    @property
    def awaited(self) -> str:
        return ', '.join(f'{w.what} on {w.topic}' for w in self._watches if not w.is_occasional)

    def count(self, name: str, number: int = 1) -> None:
        self._counts[name] += number

    def set_count(self, name: str, number: int) -> None:
        self._counts[name] = number

    def set_value(self, name: str, value: str) -> None:
        self._values[name] = value

    def set_problem(self, name: str, text: str, *, severe: bool = False) -> None:
        """Publish a problem and its remedy until `clear_problem` is called with the same name.

        It is logged when it is new or returns, with exponential back-off from five seconds to five
        minutes. `severe` raises the level from WARN to ERROR.
        """
        level = DiagnosticStatus.ERROR if severe else DiagnosticStatus.WARN
        if name not in self._problems:
            backoff = self._backoffs.setdefault(name, Backoff(_LOG_PERIOD_S, _MAX_LOG_PERIOD_S))
            if backoff.due([name], time.monotonic()):
                self._node.get_logger().warning(text)
        self._problems[name] = _Problem(level, text)

    def report_problem(self, name: str, text: str, *, severe: bool = False) -> None:
        if text:
            self.set_problem(name, text, severe=severe)
        else:
            self.clear_problem(name)

    def clear_problem(self, name: str) -> None:
        self._problems.pop(name, None)

    def report(self, error: HoidError, what: str = 'messages refused') -> None:
        """Count an error as `what`, and log it, but similar errors only once in five seconds."""
        self.count(what)
        kind = f'{what}: {str(error).split(maxsplit=1)[0]}'
        num_suppressed = self._throttle.allow(kind, time.monotonic())
        if num_suppressed is not None:
            more = f' ({num_suppressed} similar errors not shown)' if num_suppressed else ''
            self._node.get_logger().error(f'{error}{more}')

    def note(self, text: str, what: str) -> None:
        """Count an event under the name `what`, and log it at most once in five seconds."""
        self.count(what)
        if self._throttle.allow(what, time.monotonic()) is not None:
            self._node.get_logger().info(text)

    def status(self) -> DiagnosticStatus:
        texts = [*self._missing_inputs().values(), *self._other_problems().values()]
        warnings = [_Problem(DiagnosticStatus.WARN, text) for text in texts]
        problems = [*self._problems.values(), *warnings]
        level = max((level for level, _ in problems), default=DiagnosticStatus.OK)
        received = {f'{w.what} received': w.num_received for w in self._watches}
        lost = {f'{w.what} lost': w.num_lost for w in self._watches}
        counts = received | lost | self._counts  # a copy, since other threads count as well
        values = self._values | {key: str(number) for key, number in counts.items()}
        return DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message='; '.join(text for _, text in problems) or 'running',
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def _missing_inputs(self) -> dict[str, str]:
        now_s = time.monotonic()
        return {
            watch.topic: watch.missing_message(now_s, self._offered(watch.topic))
            for watch in self._watches
            if watch.is_missing(now_s)
        }

    def _other_problems(self) -> dict[str, str]:
        now_s = time.monotonic()
        texts = {
            f'{watch.topic} loses messages': watch.loss_message(
                now_s, self._profile, is_own=self._is_of_suite(watch.topic)
            )
            for watch in self._watches
            if watch.is_losing(now_s)
        }
        if problem := self._clock_message():
            texts['clock'] = problem
        return texts

    def _clock_message(self) -> str:
        clock = self._node.get_clock()
        if clock.ros_time_is_active and clock.now().nanoseconds == 0:
            return (
                'use_sim_time is set, but no message was received on /clock: start what publishes '
                'it, or set use_sim_time to false'
            )
        return ''

    def _offered(self, topic: str) -> list[str]:
        infos = self._node.get_publishers_info_by_topic(topic)
        return [info.qos_profile.reliability.name.lower() for info in infos]

    def _is_of_suite(self, topic: str) -> bool:
        """Return whether a topic has publishers, all of which are nodes of the suite."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        return bool(publishers) and all(info.node_name in _SUITE for info in publishers)

    def _is_cause(self, topic: str) -> bool:
        """Return whether this node logs that the messages of a topic are missing.

        Otherwise all nodes would log one missing camera. A silent node of the suite logs its own
        missing inputs. Any other missing topic is logged by the filter if it subscribes to the
        topic, else by every node that waits for it.
        """
        if self._is_of_suite(topic):
            return False
        subscribers = self._node.get_subscriptions_info_by_topic(topic)
        is_filter = self._node.get_name() == _FILTER
        return is_filter or all(info.node_name != _FILTER for info in subscribers)

    def _check_namesakes(self) -> None:
        """Report another node with the name of this one, which publishes on the same topics."""
        namespace, name = self._node.get_namespace(), self._node.get_name()
        if self._node.get_node_names_and_namespaces().count((name, namespace)) < 2:
            self._alone_s = time.monotonic()
            self.clear_problem(_NAMESAKE)
        elif time.monotonic() - self._alone_s > _NAMESAKE_S:
            self.set_problem(
                _NAMESAKE,
                f'another node named {self._node.get_fully_qualified_name()} runs in ROS domain '
                f'{os.environ.get("ROS_DOMAIN_ID", "0")}, and publishes on the same topics: end '
                'one of them, or give it another namespace or ROS_DOMAIN_ID',
            )

    def _publish(self) -> None:
        self._check_namesakes()
        msg = DiagnosticArray(status=[self.status()])
        msg.header.stamp = self._node.get_clock().now().to_msg()
        missing, others = self._missing_inputs(), self._other_problems()
        self._input_log.update(time.monotonic(), self._watches, missing, others)
        self._publisher.publish(msg)


def _transport_profile() -> str:
    """Return the path of the Fast DDS profile in use, else of the suite's profile, else ''."""
    if not uses_fast_dds():
        return ''
    if given := full_profile():
        return given
    try:
        share = get_package_share_directory('hoid_common')
    except PackageNotFoundError:
        return ''
    return str(Path(share) / 'config' / 'fastdds_profile.xml')
