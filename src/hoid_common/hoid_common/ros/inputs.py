"""Subscriptions: QoS and transport by parameter, silence and bad messages reported."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image

from hoid_common import topics
from hoid_common.errors import HoidError, MessageError
from hoid_common.inputs.input_config import InputConfig
from hoid_common.ros import qos
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.lifecycle import ManagedNode

__all__ = ['InputConfig', 'Inputs']

Callback = Callable[[Any], None]


class Inputs:
    """Makes the subscriptions of a node; a managed one takes messages only while it is active.

    Every callback may raise HoidError: the message is then refused, counted and logged, and the
    node lives on.
    """

    def __init__(self, node: Node, config: InputConfig, diagnostics: Diagnostics) -> None:
        self._node = node
        self._config = config
        self._diagnostics = diagnostics

    def color(self, callback: Callback, topic: str = topics.RGB_IMAGE) -> Subscription:
        """Subscribe to colour; the callback gets what `conversions.color_from_msg` takes."""
        if self._config.compressed:
            topic = topics.compressed(topic)
        return self.messages(self._image_type, topic, callback, 'colour images')

    def depth(self, callback: Callback, topic: str = topics.DEPTH_IMAGE) -> Subscription:
        """Subscribe to depth; the callback gets what `conversions.depth_from_msg` takes."""
        if self._config.compressed:
            topic = topics.compressed_depth(topic)
        return self.messages(self._image_type, topic, callback, 'depth images')

    def messages(
        self,
        type_: type[Any],
        topic: str,
        callback: Callback,
        what: str,
        *,
        reliability: str | None = None,
        is_occasional: bool = False,
    ) -> Subscription:
        """Subscribe to a topic whose messages are called `what`, in the plural.

        Args:
            type_: Of the messages.
            topic: Their topic.
            callback: Takes a message, or refuses it by a HoidError.
            what: The messages, in the plural.
            reliability: What to ask for; by default what the parameters say.
            is_occasional: Whether silence is nothing to complain of.
        """
        reliability = reliability or self._config.reliability

        def guarded(data: bytes) -> None:
            watch.heard(time.monotonic())
            if isinstance(self._node, ManagedNode) and not self._node.is_active:
                return
            try:
                callback(_decoded(data, type_, watch.topic))
            except HoidError as error:
                self._diagnostics.report(error, f'{what} refused')

        profile = qos.input_qos(reliability, self._config.queue_length)
        # Raw: the middleware drops what it cannot decode without a word, and text that is no UTF-8
        # would end the executor. It costs 0.07 ms an image.
        subscription = self._node.create_subscription(type_, topic, guarded, profile, raw=True)
        watch = self._diagnostics.watch(
            subscription, what, reliability, is_occasional=is_occasional
        )
        return subscription

    @property
    def _image_type(self) -> type[Any]:
        type_: type[Any] = CompressedImage if self._config.compressed else Image
        return type_


def _decoded(data: bytes, type_: type[Any], topic: str) -> Any:
    """Return the message of serialised bytes; raise MessageError where they are none."""
    try:
        return deserialize_message(data, type_)
    except (RuntimeError, ValueError, MemoryError) as error:  # rclpy's RMWError; no UTF-8; lengths
        name = f'{type_.__module__.partition(".")[0]}/{type_.__name__}'
        raise MessageError(
            f'{topic}: {len(data)} bytes are no {name}: is the publisher built with the '
            'same message definitions?'
        ) from error
