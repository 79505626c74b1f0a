"""Recording of topics into a bag."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from tqdm import tqdm

from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.live.ros_session import from_rclpy_qos, ros_session
from hoid_bags.storage.bag_types import message_class
from hoid_common import topics
from hoid_common.errors import ConfigError, InputError
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.ros.qos import profile

RESULT_TOPICS = (
    topics.DETECTIONS,
    topics.DYNAMIC_OBJECTS,
    topics.ODOM,
    topics.PATH,
    topics.MAP_POINTS,
    topics.CLOUD_MAP,
    topics.GRID_MAP,
    topics.GRID_MAP_UPDATES,
    topics.KEYFRAMES,
    topics.SLAM_STATUS,
    topics.TRACKED_OBJECTS,
    topics.PEOPLE,
    topics.OBJECT_MAP,
    *(relative for _, relative in topics.NAMESPACED_TF),
)
"""Topics that are recorded by default."""

# Chosen: until a new publisher is discovered, up to three images are lost; topics with
# transient-local durability lose nothing.
_DISCOVERY_PERIOD_S = 0.1
_FLUSH_PERIOD_S = 0.5  # chosen: a killed recorder loses about the messages of this time
_QUEUE_DEPTH = 100  # chosen: about three seconds of images


def record(
    bag: Path,
    topic_names: tuple[str, ...] = RESULT_TOPICS,
    *,
    namespace: str = '',
    duration_s: float = 0.0,
    use_sim_time: bool = False,
    show_progress: bool = False,
) -> int:
    """Record topics for a time or until a KeyboardInterrupt; return the number of messages.

    Each topic is subscribed to when its first publisher appears. If the process is killed, a
    hidden folder remains with all messages except those of about the last half second; `repair`
    turns it into a bag. ConfigError if the duration is negative, or the namespace is not a valid
    name. InputError if nothing arrived, a message type is unknown, or the bag exists already or
    cannot be written. No part of the new bag remains.

    Args:
        duration_s: Time to record after the first message, in s of real time; 0 = until
            interrupted.
        use_sim_time: Whether log times are those of /clock instead of the wall clock. Messages
            that arrive before the first time on /clock are not recorded then.
    """
    if not duration_s >= 0:  # also refuses NaN
        raise ConfigError(f'--duration {duration_s:g}: must be at least 0')
    with (
        ros_session('hoid_record', namespace, use_sim_time=use_sim_time) as node,
        tqdm(unit=' messages', disable=None if show_progress else True) as bar,
        BagWriter(bag) as writer,  # closed first: leaving the ROS graph takes long
    ):
        recorder = Recorder(node, writer, topic_names)
        with suppress(KeyboardInterrupt):  # Ctrl-C is the usual end
            recorder.run(duration_s, bar.update)
        if not recorder.num_messages:
            raise InputError(
                f'{bag}: nothing was recorded on {", ".join(topic_names)}; are these '
                'topics published?'
            )
        return recorder.num_messages


class Recorder:
    """Subscriber of the given topics that writes their serialized messages into a bag."""

    def __init__(self, node: Node, writer: BagWriter, topic_names: tuple[str, ...]) -> None:
        self._node, self._writer = node, writer
        self._awaited = {node.resolve_topic_name(name) for name in topic_names}
        self._executor = SteadyExecutor()
        self._executor.add_node(node)
        self.num_messages = 0

    def run(self, duration_s: float, on_messages: Callable[[int], object]) -> None:
        """Record messages until `duration_s` after the first one, and flush the bag now and then.

        `on_messages` is called about ten times per second with the number of new messages.
        InputError: a message type is unknown, or the bag cannot be written.
        """
        look_s = end_s = flush_s = 0.0
        while not end_s or time.monotonic() < end_s:
            before = self.num_messages
            if self._awaited and time.monotonic() >= look_s:
                self._subscribe_new()
                look_s = time.monotonic() + _DISCOVERY_PERIOD_S
            self._executor.spin_once(timeout_sec=_DISCOVERY_PERIOD_S)
            if time.monotonic() >= flush_s:
                self._writer.flush()
                flush_s = time.monotonic() + _FLUSH_PERIOD_S
            on_messages(self.num_messages - before)
            if duration_s and not end_s and self.num_messages:
                end_s = time.monotonic() + duration_s

    def _subscribe_new(self) -> None:
        for name, types in self._node.get_topic_names_and_types():
            publishers = self._node.get_publishers_info_by_topic(name)
            if name in self._awaited and publishers:
                self._subscribe(name, types[0], _matching_qos(publishers))
                self._awaited.remove(name)

    def _subscribe(self, name: str, type_name: str, qos: QoSProfile) -> None:
        kind = message_class(name, type_name)
        self._writer.add_topic(name, type_name, from_rclpy_qos(qos))

        def on_message(data: bytes) -> None:
            now_ns = self._node.get_clock().now().nanoseconds
            if now_ns:  # simulated time has begun
                self._writer.write_serialized(name, now_ns, data)
                self.num_messages += 1

        self._node.create_subscription(kind, name, on_message, qos, raw=True)


def _matching_qos(publishers: list[TopicEndpointInfo]) -> QoSProfile:
    """Return the QoS profile with most guarantees that is compatible with every publisher."""
    offered = [publisher.qos_profile for publisher in publishers]
    return profile(
        _QUEUE_DEPTH,
        reliable=all(p.reliability == ReliabilityPolicy.RELIABLE for p in offered),
        latched=all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in offered),
    )
