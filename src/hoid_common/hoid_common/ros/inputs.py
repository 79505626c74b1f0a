"""Subscriptions: QoS and transport by parameter, silence and bad messages reported."""

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

__all__ = ['InputConfig', 'Inputs', 'guarded']

Callback = Callable[[Any], None]

_IMAGES = (Image, CompressedImage)
_MAX_BYTES = 2_000_000  # of any other message: to take one apart takes a second


class Inputs:
    """Makes the subscriptions of a node; a managed one takes messages only while it is active.

    Every callback may raise HoidError: the message is then refused, counted and logged, and the
    node lives on.
    """

    def __init__(self, node: Node, config: InputConfig, diagnostics: Diagnostics) -> None:
        self._node = node
        self._config = config
        self._diagnostics = diagnostics

    def color(self, callback: Callback, topic: str = topics.RGB_IMAGE) -> None:
        """Subscribe to colour; the callback gets what `conversions.color_from_msg` takes."""
        if self._config.compressed:
            topic = topics.compressed(topic)
        self.messages(self._image_type, topic, callback, 'colour images')

    def depth(self, callback: Callback, topic: str = topics.DEPTH_IMAGE) -> None:
        """Subscribe to depth; the callback gets what `conversions.depth_from_msg` takes."""
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
        """Subscribe to a topic whose messages are called `what`, in the plural.

        Args:
            type_: Of the messages.
            topic: Their topic.
            callback: Takes a message, or refuses it by a HoidError.
            what: The messages, in the plural.
            reliability: What to ask for; by default what the parameters say.
            is_occasional: Whether silence is nothing to complain of.
        """
        config, full_name = self._config, self._node.resolve_topic_name(topic)
        asked = reliability or config.reliability
        may_ask_less = asked == AUTO
        if asked == AUTO:
            asked = RELIABLE if config.compressed else BEST_EFFORT
        watch = self._diagnostics.watch(full_name, what, asked, is_occasional=is_occasional)
        take = guarded(callback, type_, full_name, what, self._diagnostics)
        source = _Input(self._node, watch, take)
        source.listen(type_, topic, config.queue_length, may_ask_less=may_ask_less)

    @property
    def _image_type(self) -> type[Any]:
        type_: type[Any] = CompressedImage if self._config.compressed else Image
        return type_


class _Input:
    """One subscription of a node.

    Args:
        node: That listens; a managed one takes messages only while it is active.
        watch: Is told what comes and what gets lost.
        take: Gets the messages as bytes.
    """

    def __init__(self, node: Node, watch: InputWatch, take: Callable[[bytes], None]) -> None:
        self._node, self._watch, self._take = node, watch, take

    def listen(self, type_: type[Any], topic: str, depth: int, *, may_ask_less: bool) -> None:
        """Subscribe; anew, for whatever is offered, when that is less than what is asked for."""

        def ask_less(_info: object) -> None:
            self._node.destroy_subscription(subscription)
            self._watch.reliability = BEST_EFFORT
            self.listen(type_, topic, depth, may_ask_less=False)

        events = SubscriptionEventCallbacks(message_lost=self._on_lost)
        if may_ask_less and self._watch.reliability == RELIABLE:
            events.incompatible_qos = ask_less
        # Raw: the middleware drops what it cannot decode without a word, and text that is no UTF-8
        # would end the executor. It also spares the copies of `conversions.image_from_cdr`.
        subscription = self._node.create_subscription(
            type_, topic, self._on_message,
            qos.input_qos(self._watch.reliability, depth), raw=True, event_callbacks=events,
        )  # fmt: skip

    def _on_message(self, data: bytes) -> None:
        self._watch.heard(time.monotonic())
        if not isinstance(self._node, ManagedNode) or self._node.is_active:
            self._take(data)

    def _on_lost(self, info: Any) -> None:
        self._watch.lost(time.monotonic(), info.total_count_change)


def guarded(
    callback: Callback, type_: type[Any], topic: str, what: str, diagnostics: Diagnostics
) -> Callable[[bytes], None]:
    """Return the callback of a raw subscription, which counts and logs what it refuses.

    Args:
        callback: Gets the messages; may raise HoidError.
        type_: Of the messages.
        topic: Where they come from.
        what: They are called, in the plural.
        diagnostics: Of the node.
    """

    def take(data: bytes) -> None:
        try:
            callback(_decoded(data, type_, topic))
        except HoidError as error:
            diagnostics.report(error, f'{what} refused')

    return take


def _decoded(data: bytes, type_: type[Any], topic: str) -> Any:
    """Return the message of serialised bytes; raise MessageError where they are none.

    An Image becomes a `conversions.ReceivedImage`.
    """
    if len(data) > _MAX_BYTES and type_ not in _IMAGES:
        raise MessageError(f'{topic}: {len(data)} bytes are more than any message has')
    try:
        if type_ is Image:
            return conversions.image_from_cdr(data)
        return deserialize_message(data, type_)
    # No image; rclpy's RMWError; no UTF-8; lengths.
    except (MessageError, RuntimeError, ValueError, MemoryError) as error:
        name = f'{type_.__module__.partition(".")[0]}/{type_.__name__}'
        raise MessageError(
            f'{topic}: {len(data)} bytes are no {name}: is the publisher built with the '
            'same message definitions?'
        ) from error
