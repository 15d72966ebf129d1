"""The writer of MCAP files with checksums: of every chunk, and of the index at the end."""

from __future__ import annotations

import struct
from binascii import crc32
from types import MappingProxyType

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from softsim_ros.recording.budgets import write_summary_checksum

CRC_OFFSET = 9 + 24
"""Where the checksum stands in a chunk: after the record's head, two times and the unpacked size."""


class ChecksummedMcap(McapWriter):
    """An MCAP file whose chunks and summary carry their CRC-32; by itself the writer leaves them out."""

    def close_chunk(self) -> None:
        """Write the pending chunk, with its checksum."""
        begin, checksum = self.bio.tell(), crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin + CRC_OFFSET)
        self.bio.write(struct.pack("<I", checksum))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Write index and metadata, with their checksum."""
        super().close(version, metadata)
        write_summary_checksum(self.path)


class ChecksummedWriter(Writer):
    """A writer of bags whose MCAP files carry checksums."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChecksummedMcap})
