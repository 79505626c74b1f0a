"""Transport of messages between nodes."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message, serialize_message


def sent(msg: Any) -> Any:
    """Return a message after serialization and deserialization."""
    return deserialize_message(serialize_message(msg), type(msg))
