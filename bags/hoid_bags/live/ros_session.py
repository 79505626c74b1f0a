"""ROS node of a command, and conversion of QoS profiles and topic names between bags and ROS."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosbags.interfaces import Qos, QosDurability, QosReliability

from hoid_bags.storage.qos_profiles import recorded_qos
from hoid_common import topics
from hoid_common.errors import ConfigError, replaced_by
from hoid_common.process.shared_memory import restrict_segments, shared_memory_problem
from hoid_common.process.signals import interrupt_on_termination
from hoid_common.ros.qos import profile
from hoid_common.ros.run import limit_exit_time

_DEFAULT_DEPTH = 10  # queue length if the profile of a topic in the bag has none; rclpy's default
_SHARED_TOPICS = (topics.CLOCK, topics.DIAGNOSTICS)


@contextmanager
def ros_session(name: str, namespace: str = '', *, use_sim_time: bool = False) -> Iterator[Node]:
    """Initialize ROS for the block, and yield a new node.

    In the block, SIGINT and the first termination signal raise KeyboardInterrupt. ConfigError if
    the namespace is not a valid ROS namespace.
    """
    arguments = ['--ros-args', '-p', f'use_sim_time:={str(use_sim_time).lower()}']
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    interrupt_on_termination()
    node: Node | None = None
    try:
        problem = ConfigError(f'--namespace {namespace}: not a valid ROS namespace')
        with replaced_by(problem, ValueError):
            node = Node(name, namespace=namespace, start_parameter_services=False)
        restrict_segments()
        if text := shared_memory_problem():
            node.get_logger().warning(text)
        yield node
    finally:
        limit_exit_time()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        signal.alarm(0)


def to_rclpy_qos(qos: Qos | None) -> QoSProfile:
    """Return the rclpy profile of a bag's QoS profile; None gives the reliable default."""
    qos = qos or recorded_qos()
    return profile(
        qos.depth or _DEFAULT_DEPTH,
        reliable=qos.reliability != QosReliability.BEST_EFFORT,
        latched=qos.durability == QosDurability.TRANSIENT_LOCAL,
    )


def from_rclpy_qos(qos: QoSProfile) -> Qos:
    """Return the bag profile with the reliability and durability of an rclpy profile."""
    return recorded_qos(
        reliable=qos.reliability != ReliabilityPolicy.BEST_EFFORT,
        latched=qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )


def live_name(topic: str) -> str:
    """Return the name under which a topic of a bag is published: relative to the namespace.

    All nodes share /clock and /diagnostics; each namespace has a frame tree of its own.
    """
    return topic if topic in _SHARED_TOPICS else topic.lstrip('/')
