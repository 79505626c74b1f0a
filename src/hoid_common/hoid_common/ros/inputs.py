"""Subscriptions of nodes, with QoS and transport from parameters, and their synchronization."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from hoid_msgs.msg import KeyframePoses
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.errors import HoidError, MessageError, prefixed
from hoid_common.inputs.input_config import AUTO, BEST_EFFORT, RELIABLE, InputConfig
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.io.camera_info import rectification_doubt
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.sync import Match, StampMatcher
from hoid_common.values import NS_PER_S, CameraModel

Callback = Callable[[Any], None]

# Compressed topics by the name of the raw one.
_PACKED = {
    topics.RGB_IMAGE: topics.compressed(topics.RGB_IMAGE),
    topics.DEPTH_IMAGE: topics.compressed_depth(topics.DEPTH_IMAGE),
}
# Message types with large arrays, which have no size limit.
_LARGE = (Image, CompressedImage, KeyframePoses)
# Chosen: a new node waits so long in all for the publishers that already run, before it
# subscribes. With the suite's Fast DDS profile they are known within 0.2 s.
_DISCOVERY_S = 0.3
_POLL_S = 0.02  # chosen: period of the search for these publishers
_LOOK_S = 0.5  # chosen: period of the search for a transient-local publisher
# A larger message of a type that is not in `_LARGE` is refused. Deserializing a message of this
# size takes a second.
_MAX_BYTES = 2_000_000


class Inputs:
    """Creates the subscriptions of a node; a message whose callback raises is counted and logged.

    A `ManagedNode` processes messages only while it is active.
    """

    def __init__(self, node: Node, config: InputConfig, diagnostics: Diagnostics) -> None:
        self._node = node
        self._config = config
        self._diagnostics = diagnostics
        self._discovered_s = time.monotonic() + _DISCOVERY_S

    def color(self, callback: Callback) -> None:
        """Subscribe to color images, compressed ones by parameter or by the topic's name."""
        named = self.with_frame(callback, 'color images')
        self._images(topics.RGB_IMAGE, named, 'color images')

    def depth(self, callback: Callback) -> None:
        """Subscribe to depth images, with stamps corrected by the parameter `depth_offset_s`."""
        offset_ns = round(self._config.depth_offset_s * NS_PER_S)

        def on_depth(msg: Any) -> None:
            stamp_ns = conversions.stamp_from_msg(msg.header.stamp) - offset_ns
            msg.header.stamp = conversions.stamp_to_msg(max(stamp_ns, 0))
            callback(msg)

        self._images(topics.DEPTH_IMAGE, on_depth if offset_ns else callback, 'depth images')

    def camera(self, callback: Callable[[CameraModel, Header], None]) -> None:
        """Subscribe to the camera_info of the color images.

        The name of the image topic decides whether the images count as rectified; the diagnostics
        report a doubtful name.
        """

        def on_camera_info(msg: CameraInfo) -> None:
            topic = self._node.resolve_topic_name(self._image_topic(topics.RGB_IMAGE))
            camera = conversions.camera_from_msg(msg, topic)
            self._diagnostics.report_problem('rectification', rectification_doubt(msg, topic))
            callback(camera, msg.header)

        named = self.with_frame(on_camera_info, 'camera infos')
        self.messages(CameraInfo, topics.CAMERA_INFO, named, 'camera infos', is_latched=True)

    def depth_camera(self, callback: Callable[[CameraModel], None]) -> None:
        """Subscribe to the camera_info of the depth images, which drivers need not publish."""
        images = self._node.resolve_topic_name(self._image_topic(topics.DEPTH_IMAGE))
        topic = topics.camera_info_beside(images)
        if topic != self._node.resolve_topic_name(topics.CAMERA_INFO):
            self.messages(
                CameraInfo,
                topic,
                lambda msg: callback(conversions.camera_from_msg(msg, images)),
                'camera infos of depth',
                is_occasional=True,
                is_latched=True,
            )

    def with_frame(self, callback: Callback, what: str) -> Callback:
        """Return a callback that completes the frame name of a message before it calls `callback`.

        An empty name is replaced by the parameter `camera_frame`; if that is empty too, the
        diagnostics report a problem, and MessageError is raised. `what` is such as "color images".
        """

        def on_message(msg: Any) -> None:
            try:
                frame = conversions.camera_frame(msg.header, self._config.camera_frame)
            except MessageError as error:
                self._diagnostics.set_problem(f'frame of {what}', f'{what}: {error}', severe=True)
                raise
            self._diagnostics.clear_problem(f'frame of {what}')
            msg.header.frame_id = frame
            callback(msg)

        return on_message

    def _images(self, raw: str, callback: Callback, what: str) -> None:
        topic = self._image_topic(raw)
        full_name = self._node.resolve_topic_name(topic)
        if not topics.is_compressed(full_name):
            self.messages(Image, topic, callback, what)
            return

        def on_compressed(msg: CompressedImage) -> None:
            # The topic is named, because which plugin has compressed the images is unknown.
            with prefixed(f'{full_name}: ', MessageError, MessageError):
                callback(msg)

        self.messages(CompressedImage, topic, on_compressed, what)

    def _image_topic(self, raw: str) -> str:
        """Return the compressed topic if that is set and `raw` is not remapped to such a name."""
        is_named = topics.is_compressed(self._node.resolve_topic_name(raw))
        return _PACKED[raw] if self._config.compressed and not is_named else raw

    def messages(
        self,
        type_: type[Any],
        topic: str,
        callback: Callback,
        what: str,
        *,
        reliability: str | None = None,
        is_occasional: bool = False,
        is_latched: bool = False,
        queue_length: int | None = None,
    ) -> None:
        """Subscribe to a topic.

        `what` names the messages in log lines, in the plural. Missing messages are reported,
        unless the topic is occasional, or latched and one message has arrived. Reliability and
        queue length come from the parameters by default.
        """
        config, full_name = self._config, self._node.resolve_topic_name(topic)
        requested = reliability or config.reliability
        watch = self._diagnostics.watch(
            full_name, what, requested, is_occasional=is_occasional, is_latched=is_latched
        )
        on_bytes = checked_callback(callback, type_, full_name, what, self._diagnostics)
        depth = queue_length or config.queue_length
        _Input(self._node, watch, on_bytes, type_, topic, depth, self._discovered_s)


class _Input:
    """The subscription of an input.

    With reliability `auto` it is reliable until a publisher offers best effort only; then it is
    best effort until the topic has no publisher.
    """

    def __init__(
        self,
        node: Node,
        watch: InputWatch,
        on_bytes: Callable[[bytes], None],
        type_: type[Any],
        topic: str,
        depth: int,
        discovered_s: float,
    ) -> None:
        self._node, self._watch, self._on_bytes = node, watch, on_bytes
        self._type, self._topic, self._depth = type_, topic, depth
        self._last: tuple[bytes, float] | None = None  # last latched message, and its time
        self._has_latched = False  # whether there is a second subscription
        if watch.reliability == AUTO and self._offers_best_effort(discovered_s):
            self._request_best_effort()
        elif watch.reliability == AUTO:
            self._request_reliable()
        else:
            self._subscribe(watch.reliability)
        if watch.is_latched:
            # The search for transient-local publishers starts after one period, because drivers
            # log each subscription that requests more than they offer.
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(_LOOK_S, self._find_latched, clock=steady)
            if isinstance(node, ManagedNode):
                node.on_activation.append(self._repeat_last)

    def _offers_best_effort(self, until_s: float) -> bool:
        """Return whether a publisher that already runs offers best effort only.

        A driver logs each subscription that requests more than it offers. Therefore publishers are
        searched for first, until `until_s` of the monotonic clock.
        """
        while True:
            infos = self._node.get_publishers_info_by_topic(self._watch.topic)
            if infos or time.monotonic() > until_s:
                weak = ReliabilityPolicy.BEST_EFFORT
                return any(info.qos_profile.reliability == weak for info in infos)
            time.sleep(_POLL_S)

    def _request_reliable(self) -> None:
        def relax(_info: object) -> None:
            self._node.destroy_subscription(subscription)
            self._request_best_effort()

        subscription = self._subscribe(RELIABLE, incompatible_qos=relax)

    def _request_best_effort(self) -> None:
        def restore(info: Any) -> None:
            if info.current_count == 0:  # no publisher is left that could offer less
                self._node.destroy_subscription(subscription)
                self._request_reliable()

        subscription = self._subscribe(BEST_EFFORT, matched=restore)

    def _subscribe(self, reliability: str, **events: Callable[[Any], None]) -> Subscription[Any]:
        self._watch.reliability = reliability
        return self._make(
            qos.input_qos(reliability, self._depth),
            SubscriptionEventCallbacks(message_lost=self._on_lost, **events),
        )

    def _make(self, profile: QoSProfile, events: SubscriptionEventCallbacks) -> Subscription[Any]:
        # raw=True: otherwise the middleware silently drops messages that it cannot deserialize,
        # and text that is not UTF-8 raises in the executor. `image_from_cdr` also avoids the
        # copies of rclpy.
        return self._node.create_subscription(
            self._type, self._topic, self._on_message, profile, raw=True, event_callbacks=events
        )

    def _find_latched(self) -> None:
        """Add a transient-local subscription if a publisher offers one."""
        infos = self._node.get_publishers_info_by_topic(self._watch.topic)
        kept = DurabilityPolicy.TRANSIENT_LOCAL
        if any(info.qos_profile.durability == kept for info in infos):
            self._timer.cancel()
            self._has_latched = True
            self._make(qos.LATCHED, SubscriptionEventCallbacks(use_default_callbacks=False))

    def _on_message(self, data: bytes) -> None:
        now_s = time.monotonic()
        if self._watch.is_latched:
            last, self._last = self._last, (data, now_s)
            is_repeated = last is not None and last[0] == data and now_s - last[1] < _LOOK_S
            if self._has_latched and is_repeated:  # both subscriptions have received it
                return
        self._watch.record_message(now_s)
        if not isinstance(self._node, ManagedNode) or self._node.is_active:
            self._on_bytes(data)

    def _repeat_last(self) -> None:
        """Process the last latched message (again) when the node becomes active."""
        if self._has_latched and self._last is not None:
            self._on_bytes(self._last[0])

    def _on_lost(self, info: Any) -> None:
        self._watch.record_loss(time.monotonic(), info.total_count_change)


def checked_callback(
    callback: Callback, type_: type[Any], topic: str, what: str, diagnostics: Diagnostics
) -> Callable[[bytes], None]:
    """Return a function that calls `callback` with deserialized bytes and reports HoidErrors."""

    def on_bytes(data: bytes) -> None:
        try:
            callback(_decoded(data, type_, topic))
        except HoidError as error:
            diagnostics.report(error, f'{what} refused')

    return on_bytes


def _decoded(data: bytes, type_: type[Any], topic: str) -> Any:
    """Return the deserialized message (a `ReceivedImage` for Image); MessageError if invalid."""
    if len(data) > _MAX_BYTES and type_ not in _LARGE:
        raise MessageError(f'{topic}: message of {len(data)} bytes exceeds {_MAX_BYTES} bytes')
    try:
        if type_ is Image:
            return conversions.image_from_cdr(data)
        return deserialize_message(data, type_)
    # image_from_cdr raises MessageError. rclpy raises RMWError (a RuntimeError), ValueError for
    # text that is not UTF-8, and MemoryError for impossible lengths.
    except (MessageError, RuntimeError, ValueError, MemoryError) as error:
        name = f'{type_.__module__.partition(".")[0]}/{type_.__name__}'
        raise MessageError(
            f'{topic}: {len(data)} bytes are no {name}; check that the publisher is built with '
            'the same message definitions'
        ) from error


class Stamped(NamedTuple):
    """The converted content of a message, and the message's header."""

    header: Header
    value: Any


class Synchronizer:
    """Calls a function for each match of messages, and counts the dropped ones in diagnostics.

    The diagnostics report a problem while the stamps of the messages do not match, or while a
    constant offset of the stamps probably matches the wrong messages. A HoidError of the callback
    is counted and logged.
    """

    def __init__(
        self, matcher: StampMatcher, callback: Callable[[Match], None], diagnostics: Diagnostics
    ) -> None:
        self._matcher = matcher
        self._callback = callback
        self._diagnostics = diagnostics

    def input(self, name: str, convert: Callable[[Any], Any]) -> Callable[[Any], None]:
        """Return the subscription callback of the stream `name`.

        `convert` turns a message into the value that matches contain.
        """

        def on_message(msg: Any) -> None:
            value = Stamped(msg.header, convert(msg))
            matches = self._matcher.add(name, stamp_from_msg(msg.header.stamp), value)
            self._update_counts(name)
            for match in matches:
                self._call(match)

        return on_message

    def _call(self, match: Match) -> None:
        try:
            self._callback(match)
        except HoidError as error:
            self._diagnostics.report(error, 'matched images refused')

    def _update_counts(self, name: str) -> None:
        counts = self._matcher.counts[name]
        dropped = counts.unmatched + counts.overflowed + counts.late
        self._diagnostics.set_count(f'{name} dropped', dropped)
        self._diagnostics.report_problem('stamps', self._matcher.mismatch)
