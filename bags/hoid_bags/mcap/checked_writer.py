"""MCAP files that tell when they are damaged, and that a killed writer leaves readable."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

_CHECKSUM_AT: Final = 1 + 8 + 3 * 8  # in a chunk: after opcode, length, two times and the size


class CheckedMcapWriter(McapWriter):
    """rosbags' storage with each chunk's checksum, which it leaves out."""

    def close_chunk(self) -> None:
        """Write the chunk that was gathered."""
        start, checksum = self.bio.tell(), crc32(self.chunk.bio.getvalue())
        super().close_chunk()
        self.bio.seek(start + _CHECKSUM_AT)
        self.bio.write(checksum.to_bytes(4, 'little'))
        self.bio.seek(0, 2)

    def flush(self) -> None:
        """Hand all messages to the system: from here on they outlive this process."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()


class CheckedWriter(Writer):
    """rosbags' writer of whole bags, for MCAP."""

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: CheckedMcapWriter})

    def flush(self) -> None:
        """Hand all messages to the system."""
        assert isinstance(self.storage, CheckedMcapWriter)
        self.storage.flush()
