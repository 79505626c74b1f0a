"""A publisher of large messages that tells its node whether there are subscribers.

rclpy holds Python's interpreter lock while it publishes: 10 to 80 ms for a cloud of 20 MB.
Serialized messages therefore go to the C function of rcl, without the lock.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node
from rclpy.qos import QoSProfile

from hoid_common.values import ByteArray


class OnDemandPublisher:
    """Publisher of messages or serialized messages, which counts its subscribers.

    It calls `on_change` in the thread that spins the node when a subscriber has joined or left.
    """

    def __init__(
        self,
        node: Node,
        type_: type[Any],
        topic: str,
        profile: QoSProfile,
        on_change: Callable[[], None],
    ) -> None:
        def on_matched(_: QoSPublisherMatchedInfo) -> None:
            on_change()

        self.topic = topic
        events = PublisherEventCallbacks(matched=on_matched)
        self._publisher = node.create_publisher(type_, topic, profile, event_callbacks=events)

    @property
    def is_wanted(self) -> bool:
        return bool(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish a message or its CDR bytes (N,); bytes do not block other Python threads."""
        if isinstance(message, np.ndarray):
            self._publish_bytes(message)
        else:
            self._publisher.publish(message)

    def _publish_bytes(self, data: ByteArray) -> None:
        handle = self._publisher.handle
        with handle:
            message = _SerializedMessage(data.ctypes.data, len(data), len(data), _Allocator())
            status = _rcl_publish()(handle.pointer, ctypes.byref(message), None)
        if status != 0:
            self._publisher.publish(data.tobytes())  # raises rclpy's error, with a text


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t, which publishing does not use."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ('allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state')
    ]


class _SerializedMessage(ctypes.Structure):
    """rmw_serialized_message_t, which is rcutils_uint8_array_t."""

    _fields_ = [
        ('buffer', ctypes.c_void_p),
        ('buffer_length', ctypes.c_size_t),
        ('buffer_capacity', ctypes.c_size_t),
        ('allocator', _Allocator),
    ]


@cache
def _rcl_publish() -> Any:
    function = ctypes.CDLL('librcl.so').rcl_publish_serialized_message
    function.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    function.restype = ctypes.c_int32
    return function
