"""Reads all messages of a bag, and copies bags with their messages rewritten."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.contents import BagMessage
from hoid_bags.storage import bag_types


def read_messages(bag: Path) -> list[BagMessage]:
    """Return the readable messages of a bag."""
    with BagReader(bag) as reader:
        return list(reader.messages())


def copy_bag(
    bag: Path, to: Path, rewrite: Callable[[Connection, int, bytes], bytes], *, pack: bool = False
) -> None:
    """Copy a bag with its messages rewritten.

    Args:
        bag: The bag.
        to: The copy.
        rewrite: Returns the new content of a message, by its connection, time of logging and
            content.
        pack: Whether to pack each message, as `ros2 bag record --compression-mode message` does.
    """
    unopened = Writer(to, version=9, storage_plugin=StoragePlugin.MCAP)
    if pack:
        unopened.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with Reader(bag) as reader, unopened as writer:
        copies = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=bag_types.shared_typestore())
            for c in reader.connections
        }
        for connection, log_ns, data in reader.messages():
            writer.write(copies[connection.id], log_ns, rewrite(connection, log_ns, data))
