"""Playback of a bag on topics, in real time."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import TopicChoice
from hoid_bags.live.keyboard import PAUSE_KEY, KeyPresses
from hoid_bags.live.lockstep import LockstepGate
from hoid_bags.live.playback import Pacer, PlaybackPlan, PlayConfig, ScheduledMessage, open_plan
from hoid_bags.live.read_ahead import ReadAhead
from hoid_bags.live.ros_session import live_name, ros_session, to_rclpy_qos
from hoid_bags.storage.bag_types import message_class
from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import qos
from hoid_common.ros.conversions import stamp_from_msg, stamp_to_msg
from hoid_common.values import NS_PER_S

_LOG = logging.getLogger(__name__)
_TICK_S = 0.01  # chosen: period in which the keyboard and, in lockstep, odometry are checked
# Time between two /clock messages, in real time. Chosen: each of these messages wakes every node
# on simulated time (decision 018).
_CLOCK_PERIOD_S = 0.02
# Chosen: after it is matched, a subscriber needs up to this long to receive messages.
_SETTLE_S = 0.3
_SETTLE_LOCKSTEP_S = 1.0  # chosen: longer, because a lost frame would never be answered
_ACK_LIMIT = Duration(seconds=2)  # chosen: longest wait for the last messages to be received
_BAR = '{l_bar}{bar}| {n:.1f}/{total_fmt} s [{elapsed}] {postfix}'


def play(
    path: Path,
    config: PlayConfig | None = None,
    *,
    topic_names: tuple[str, ...] = (),
    choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
    depth_offset_ns: int = 0,
    namespace: str = '',
    min_subscribers: Mapping[str, int] | None = None,
    show_progress: bool = False,
) -> None:
    """Play a bag to its end or for the configured time; with `loop`, until a KeyboardInterrupt.

    InputError if the bag can be played only in part or not at all, a message type is unknown, or
    the subscribers of `min_subscribers` or the odometry of lockstep are missing. MessageError if a
    message is too short for the header of its type (with `loop` or lockstep). ConfigError if the
    namespace is not a valid name.

    Args:
        topic_names: Topics to play; empty means all but /clock.
        choice: Image topics that lockstep pairs; topics that are not named are searched for.
        depth_offset_ns: Time by which the stamps of depth images are too late. Only lockstep uses
            it, to pair images; published stamps stay as they are.
        namespace: Prefix of every topic except /clock and /diagnostics.
        min_subscribers: Least number of subscribers by topic before playing.
    """
    config = config or PlayConfig()
    plan = open_plan(path, config, topic_names)
    gate = (
        LockstepGate(BagSequence(path, choice=choice, depth_offset_ns=depth_offset_ns))
        if config.lockstep
        else None
    )
    with ros_session('hoid_play', namespace) as node, KeyPresses() as keys:
        player = Player(node, plan, config, keys, gate)
        player.wait_for_subscribers(min_subscribers or {})
        player.run(show_progress=show_progress)
    if gate is not None and gate.num_unanswered:
        _LOG.warning('no odometry came for %d frames', gate.num_unanswered)
    if plan.fault is not None:
        raise InputError(plan.fault)


class Player:
    """Publishes the messages of a bag when they are due, and /clock in between if configured.

    Args:
        gate: Holds images back in lockstep; None: no lockstep.
    """

    def __init__(
        self,
        node: Node,
        plan: PlaybackPlan,
        config: PlayConfig,
        keys: KeyPresses,
        gate: LockstepGate | None,
    ) -> None:
        self._plan, self._config, self._keys, self._gate = plan, config, keys, gate
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._publishers: dict[str, Publisher] = {
            topic.name: node.create_publisher(
                message_class(topic.name, topic.type_name),
                live_name(topic.name),
                to_rclpy_qos(topic.qos),
            )
            for topic in plan.topics
        }
        self._clock = (
            None if config.no_clock else node.create_publisher(Clock, topics.CLOCK, qos.CLOCK)
        )
        self._odometry_subscriptions: tuple[Subscription, ...] = ()
        if gate is not None:
            self._odometry_subscriptions = tuple(
                node.create_subscription(kind, name, self._on_odometry, qos.OUTPUT)
                for kind, name in ((Odometry, topics.ODOM), (SlamStatus, topics.SLAM_STATUS))
            )
        self._count_publishers = node.count_publishers
        self._is_paused = False
        self._clock_ns = 0
        self._clock_period_ns = round(_CLOCK_PERIOD_S * config.rate * NS_PER_S)

    def wait_for_subscribers(self, minimum: Mapping[str, int]) -> None:
        """Wait until there are enough subscribers and, in lockstep, a publisher of odometry.

        Once there are enough, the wait ends when their number has not changed for 0.3 s (1 s in
        lockstep). If any are still missing after `wait_s` seconds: InputError with a minimum, else
        a logged warning.

        Args:
            minimum: Least number of subscribers by topic; empty: one subscriber of any topic.
        """
        now_s = time.monotonic()
        deadline_s, changed_s, count = now_s + self._config.wait_s, now_s, (0, 0)
        settle_s = _SETTLE_LOCKSTEP_S if self._odometry_subscriptions else _SETTLE_S
        while now_s < deadline_s:
            if self._num_peers() != count:
                changed_s, count = now_s, self._num_peers()
            if self._missing(minimum) is None and now_s > changed_s + settle_s:
                return
            time.sleep(_TICK_S)
            now_s = time.monotonic()
        if missing := self._missing(minimum):
            if minimum:
                raise InputError(
                    f'{missing} after {self._config.wait_s:g} s; are the nodes running?'
                )
            _LOG.warning('%s after %g s; playing without', missing, self._config.wait_s)

    def run(self, *, show_progress: bool) -> None:
        """Publish all messages, each when it is due, and wait until they are received.

        The wait is at most two seconds for each topic. With the option `loop`, it never ends.
        Errors are those of `play`.
        """
        plan, config = self._plan, self._config
        span_s = (plan.end_ns - plan.start_ns) / NS_PER_S
        total_s = None if config.loop else round(span_s, 2)
        with (
            ReadAhead(plan.messages(loop=config.loop), rate=config.rate) as messages,
            tqdm(
                total=total_s, unit='s', disable=None if show_progress else True, bar_format=_BAR
            ) as bar,
        ):
            self._pacer = Pacer(plan.start_ns, config.rate)
            self._pacer.hold()  # `_wait_for` releases it when the first message has been read
            for message in messages:
                self._wait_for(message)
                self._publish(message)
                bar.set_postfix_str('paused' if self._is_paused else '', refresh=False)
                bar.update((message.time_ns - plan.start_ns) / NS_PER_S - bar.n)
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(_ACK_LIMIT)

    def _wait_for(self, message: ScheduledMessage) -> None:
        """Wait until a message is due; meanwhile publish the clock and read keys and odometry.

        In lockstep, the wait for odometry ends at a time limit (see `_give_up`).
        """
        limit_s = self._config.lockstep_timeout_s
        give_up_s = time.monotonic() + limit_s
        while True:
            if self._keys.read().count(PAUSE_KEY) % 2:
                self._is_paused = not self._is_paused
            remaining_s = self._pacer.remaining_s(message.time_ns)
            if self._is_paused:
                self._pacer.hold()
                give_up_s = time.monotonic() + limit_s
                self._tick(_TICK_S)
            elif remaining_s > 0:
                self._pacer.release()
                self._tick(min(remaining_s, _TICK_S))
            elif self._gate is None or not self._gate.blocks(message):
                self._pacer.release()
                return
            elif time.monotonic() > give_up_s:
                self._give_up(self._gate)
            else:  # due, but blocked: the clock is paused until the odometry comes
                self._pacer.hold()
                self._tick(_TICK_S)

    def _tick(self, at_most_s: float) -> None:
        if self._gate is not None:
            self._executor.spin_once(timeout_sec=at_most_s)
        else:
            time.sleep(at_most_s)
        self._publish_clock(self._pacer.time_ns())

    def _publish(self, message: ScheduledMessage) -> None:
        self._publish_clock(message.time_ns)
        self._publishers[message.topic].publish(message.data)
        if self._gate is not None:
            self._gate.note_published(message)

    def _publish_clock(self, time_ns: int) -> None:
        # The clock never goes backwards: the time of a late message is before that of the pacer,
        # which may have been published already.
        if self._clock is not None and time_ns >= self._clock_ns + self._clock_period_ns:
            self._clock_ns = time_ns
            self._clock.publish(Clock(clock=stamp_to_msg(time_ns)))

    def _on_odometry(self, message: Any) -> None:
        if self._gate is not None:
            self._gate.note_answer(stamp_from_msg(message.header.stamp))

    def _give_up(self, gate: LockstepGate) -> None:
        """Let the next frame pass without odometry; InputError if no odometry ever arrived."""
        if not gate.num_answered:
            raise InputError(
                f'topic "{topics.ODOM}": no odometry for the first frame after'
                f' {self._config.lockstep_timeout_s:g} s; are the nodes running?'
            )
        gate.give_up()

    def _num_peers(self) -> tuple[int, int]:
        """Return the numbers of subscribers and, in lockstep, of publishers of odometry."""
        subscribers = sum(p.get_subscription_count() for p in self._publishers.values())
        names = (subscription.topic_name for subscription in self._odometry_subscriptions)
        return subscribers, sum(map(self._count_publishers, names))

    def _missing(self, minimum: Mapping[str, int]) -> str | None:
        for name, wanted in minimum.items():
            publisher = self._publishers.get(f'/{name.lstrip("/")}')
            count = publisher.get_subscription_count() if publisher else 0
            if count < wanted:
                return f'topic "{name}": {count} of {wanted} subscribers'
        num_subscribers, num_publishers = self._num_peers()
        if self._odometry_subscriptions and not num_publishers:
            return f'topic "{topics.ODOM}": no publisher'
        return None if num_subscribers else 'no topic of the bag has a subscriber'
