"""What happens to a message on its way."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message, serialize_message


def sent(msg: Any) -> Any:
    """Return what arrives at the other end."""
    return deserialize_message(serialize_message(msg), type(msg))
