"""Writing of bags that appear only when they are complete."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, Self

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from hoid_bags.storage.bag_types import Message, ensure_type, serialize, shared_typestore
from hoid_bags.storage.checked_writer import CheckedWriter
from hoid_bags.storage.qos_profiles import recorded_qos
from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder, written
from hoid_common.process.signals import termination_signals_blocked

_METADATA_VERSION: Final = 9  # version that rosbag2 of Jazzy writes


class BagWriter:
    """Context manager that writes an MCAP bag, which appears only when it is complete.

    Until then, messages are in a hidden folder beside it, which an exception removes. All methods
    raise InputError if the path exists already or the bag cannot be written.
    """

    def __init__(self, path: Path, *, compress: bool = False) -> None:
        if path.exists():
            raise InputError(f'{path}: exists already; remove it or choose another name')
        self.path = path
        self._compress = compress
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            folder = undo.enter_context(scratch_folder(self.path.parent, self.path.name))
            # rosbags names the .mcap file after this folder, which therefore has the bag's name.
            self._aside = folder / self.path.name
            self._writer = CheckedWriter(
                self._aside, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
            )
            if self._compress:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with written(self.path):
                self._writer.open()
            self._undo = undo.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        with termination_signals_blocked(), self._undo, written(self.path):
            self._writer.__exit__(*error)
            if error[0] is None:
                self._aside.rename(self.path)

    def add_topic(self, topic: str, type_name: str, qos: Qos | None = None) -> None:
        """Add a topic, whose name becomes absolute. Without `qos`, its profile is reliable.

        InputError: the definition of the type is unknown.
        """
        ensure_type(type_name)
        self._connections[topic] = self._writer.add_connection(
            f'/{topic.lstrip("/")}',
            type_name,
            typestore=shared_typestore(),
            offered_qos_profiles=[qos or recorded_qos()],
        )

    def write(self, topic: str, stamp_ns: int, message: Message) -> None:
        connection = self._connections[topic]
        self.write_serialized(topic, stamp_ns, serialize(message, connection.msgtype))

    def write_serialized(self, topic: str, stamp_ns: int, data: bytes | memoryview) -> None:
        with written(self.path):
            self._writer.write(self._connections[topic], stamp_ns, data)

    def flush(self) -> None:
        """Pass all messages to the operating system, so that a kill of this process loses none."""
        with written(self.path):
            self._writer.flush()
