"""Subscriptions with QoS and transport by parameter, and reports of missing and bad messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image

from hoid_common import topics
from hoid_common.errors import HoidError, MessageError
from hoid_common.inputs.input_config import AUTO, BEST_EFFORT, RELIABLE, InputConfig
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.ros import conversions, qos
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.lifecycle import ManagedNode

__all__ = ['InputConfig', 'Inputs', 'checked_callback']

Callback = Callable[[Any], None]

_IMAGES = (Image, CompressedImage)
# Largest message that is no image. Deserializing one of this size takes a second.
_MAX_BYTES = 2_000_000


class Inputs:
    """Makes the subscriptions of a node. A managed node processes messages only while active.

    A HoidError that a callback raises is counted and logged, and the message is dropped.

    Args:
        node: Node that subscribes.
        config: QoS and transport.
        diagnostics: Of the node; reports missing, lost and bad messages.
    """

    def __init__(self, node: Node, config: InputConfig, diagnostics: Diagnostics) -> None:
        self._node = node
        self._config = config
        self._diagnostics = diagnostics

    def color(self, callback: Callback, topic: str = topics.RGB_IMAGE) -> None:
        """Subscribe to color images; `conversions.color_from_msg` converts the messages."""
        if self._config.compressed:
            topic = topics.compressed(topic)
        self.messages(self._image_type, topic, callback, 'color images')

    def depth(self, callback: Callback, topic: str = topics.DEPTH_IMAGE) -> None:
        """Subscribe to depth images; `conversions.depth_from_msg` converts the messages."""
        if self._config.compressed:
            topic = topics.compressed_depth(topic)
        self.messages(self._image_type, topic, callback, 'depth images')

    def messages(
        self,
        type_: type[Any],
        topic: str,
        callback: Callback,
        what: str,
        *,
        reliability: str | None = None,
        is_occasional: bool = False,
    ) -> None:
        """Subscribe to a topic.

        Args:
            type_: Type of the messages.
            topic: Name of the topic.
            callback: Called with each message; may raise HoidError.
            what: The messages in the plural, such as "depth images".
            reliability: Reliability to request; by default the parameter's.
            is_occasional: Whether silence is normal.
        """
        config, full_name = self._config, self._node.resolve_topic_name(topic)
        requested = reliability or config.reliability
        may_fall_back = requested == AUTO
        if requested == AUTO:
            requested = RELIABLE if config.compressed else BEST_EFFORT
        watch = self._diagnostics.watch(full_name, what, requested, is_occasional=is_occasional)
        on_bytes = checked_callback(callback, type_, full_name, what, self._diagnostics)
        source = _Input(self._node, watch, on_bytes)
        source.subscribe(type_, topic, config.queue_length, may_fall_back=may_fall_back)

    @property
    def _image_type(self) -> type[Any]:
        type_: type[Any] = CompressedImage if self._config.compressed else Image
        return type_


class _Input:
    """One subscription of a node.

    Args:
        node: Node that subscribes.
        watch: Counts received and lost messages.
        on_bytes: Called with each serialized message.
    """

    def __init__(self, node: Node, watch: InputWatch, on_bytes: Callable[[bytes], None]) -> None:
        self._node, self._watch, self._on_bytes = node, watch, on_bytes

    def subscribe(self, type_: type[Any], topic: str, depth: int, *, may_fall_back: bool) -> None:
        """Subscribe; fall back to best effort when a publisher offers no more, if allowed."""

        def fall_back(_info: object) -> None:
            self._node.destroy_subscription(subscription)
            self._watch.reliability = BEST_EFFORT
            self.subscribe(type_, topic, depth, may_fall_back=False)

        events = SubscriptionEventCallbacks(message_lost=self._on_lost)
        if may_fall_back and self._watch.reliability == RELIABLE:
            events.incompatible_qos = fall_back
        # raw=True: otherwise the middleware silently drops messages that it cannot deserialize,
        # and text that is not UTF-8 raises in the executor. It also lets `image_from_cdr` avoid
        # the copies of rclpy.
        subscription = self._node.create_subscription(
            type_,
            topic,
            self._on_message,
            qos.input_qos(self._watch.reliability, depth),
            raw=True,
            event_callbacks=events,
        )

    def _on_message(self, data: bytes) -> None:
        self._watch.record_message(time.monotonic())
        if not isinstance(self._node, ManagedNode) or self._node.is_active:
            self._on_bytes(data)

    def _on_lost(self, info: Any) -> None:
        self._watch.record_loss(time.monotonic(), info.total_count_change)


def checked_callback(
    callback: Callback, type_: type[Any], topic: str, what: str, diagnostics: Diagnostics
) -> Callable[[bytes], None]:
    """Return a raw subscription's callback that deserializes messages and reports their errors.

    Args:
        callback: Called with each message; may raise HoidError, which is counted and logged.
        type_: Type of the messages.
        topic: Full name of the topic.
        what: The messages in the plural, such as "depth images".
        diagnostics: Of the node.
    """

    def on_bytes(data: bytes) -> None:
        try:
            callback(_decoded(data, type_, topic))
        except HoidError as error:
            diagnostics.report(error, f'{what} refused')

    return on_bytes


def _decoded(data: bytes, type_: type[Any], topic: str) -> Any:
    """Return the message of its serialized bytes; for an Image a `conversions.ReceivedImage`.

    Raises:
        MessageError: The bytes are no such message, or too many.
    """
    if len(data) > _MAX_BYTES and type_ not in _IMAGES:
        raise MessageError(f'{topic}: message of {len(data)} bytes exceeds {_MAX_BYTES} bytes')
    try:
        if type_ is Image:
            return conversions.image_from_cdr(data)
        return deserialize_message(data, type_)
    # Of image_from_cdr, rclpy's RMWError, text that is not UTF-8, and impossible lengths.
    except (MessageError, RuntimeError, ValueError, MemoryError) as error:
        name = f'{type_.__module__.partition(".")[0]}/{type_.__name__}'
        raise MessageError(
            f'{topic}: {len(data)} bytes are no {name}; check that the publisher is built with '
            'the same message definitions'
        ) from error
