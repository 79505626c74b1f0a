"""Writing of MCAP files with checksums, by which damage is found, and with explicit flushes."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

_CHECKSUM_AT: Final = 1 + 8 + 3 * 8  # in a chunk: after opcode, length, two times and size


class CheckedMcapWriter(McapWriter):
    """MCAP writer of rosbags that also writes the checksum of each chunk."""

    def close_chunk(self) -> None:
        """Write the pending chunk, then its checksum into its header."""
        start, checksum = self.bio.tell(), crc32(self.chunk.bio.getvalue())
        super().close_chunk()
        self.bio.seek(start + _CHECKSUM_AT)
        self.bio.write(checksum.to_bytes(4, 'little'))
        self.bio.seek(0, 2)

    def flush(self) -> None:
        """Pass all messages to the operating system, so that a kill of this process loses none."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()


class CheckedWriter(Writer):
    """rosbags' writer of bags, restricted to MCAP with checksums."""

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: CheckedMcapWriter})

    def flush(self) -> None:
        """Pass all messages to the operating system, so that a kill of this process loses none."""
        assert isinstance(self.storage, CheckedMcapWriter)
        self.storage.flush()
