"""Checksums of MCAP files (CRC-32): of every chunk, of all data before the index, and of the index."""

from __future__ import annotations

import struct
from binascii import crc32
from types import MappingProxyType
from typing import Any, BinaryIO, Final, NamedTuple

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from softsim_core.file_writing import open_in_place
from softsim_ros.recording.torn_files import DATA_END, MAGIC

CRC_OFFSET: Final = 9 + 24
"""Where the checksum stands in a chunk: after the record's head, two times and the unpacked size."""

BLOCK_BYTES: Final = 2**20
"""So much of a file is read at once."""

_FOOTER: Final = struct.Struct("<QQI")
_DATA_END: Final = struct.Struct("<BQI")


class Checksum(NamedTuple):
    """A checksum that a file tells, and what its bytes give; 0 is told where the writer left it out."""

    told: int
    counted: int


def read_summary(stream: BinaryIO) -> Checksum | None:
    """The checksum of the index at the end of an MCAP file; None: it has no index."""
    begin, end, told = _footer(stream)
    return Checksum(told, _crc_of(stream, begin, end - 4)) if begin else None


def read_data_section(stream: BinaryIO) -> Checksum | None:
    """The checksum of all that stands before the index of an MCAP file; None: it has no index.

    Where the file tells none its bytes are not counted.
    """
    begin = _footer(stream)[0]
    if begin < _DATA_END.size:
        return None
    end = begin - _DATA_END.size
    stream.seek(end)
    kind, length, told = _DATA_END.unpack(stream.read(_DATA_END.size))
    if (kind, length) != (DATA_END, 4):
        return None
    return Checksum(told, _crc_of(stream, 0, end) if told else 0)


def _footer(stream: BinaryIO) -> tuple[int, int, int]:
    """Begin of the index, end of the footer behind it, checksum of the index; 0, 0, 0: there is none."""
    end = stream.seek(0, 2) - len(MAGIC)
    if end < _FOOTER.size:
        return 0, 0, 0
    stream.seek(end - _FOOTER.size)
    begin, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
    return (begin, end, checksum) if 0 < begin <= end - _FOOTER.size else (0, 0, 0)


def _crc_of(stream: BinaryIO, begin: int, end: int, before: int = 0) -> int:
    """CRC-32 of the bytes from `begin` to `end`, going on from that of what is `before` them."""
    stream.seek(begin)
    for at in range(begin, end, BLOCK_BYTES):
        before = crc32(stream.read(min(BLOCK_BYTES, end - at)), before)
    return before


class ChecksummedMcap(McapWriter):
    """An MCAP file that carries its checksums; by itself the writer leaves them out."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._counted, self._checksum = 0, 0  # of the file's first so many bytes

    def close_chunk(self) -> None:
        """Write the pending chunk, with its checksum."""
        begin, checksum = self.bio.tell(), crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin + CRC_OFFSET)
        self.bio.write(struct.pack("<I", checksum))
        self.bio.seek(end)
        self._count(end)

    def close(self, version: int, metadata: str) -> None:
        """Write index and metadata, with the checksums of the data and of the index."""
        super().close(version, metadata)
        with open_in_place(self.path, "r+b") as stream:
            begin, end, _ = _footer(stream)
            self._count(begin - _DATA_END.size)
            stream.seek(begin - 4)
            stream.write(struct.pack("<I", self._checksum))
            checksum = _crc_of(stream, begin, end - 4)
            stream.seek(end - 4)
            stream.write(struct.pack("<I", checksum))

    def _count(self, end: int) -> None:
        """Let the checksum of the data go on to the byte `end`, which is still in the system's cache."""
        if not self.bio.closed:
            self.bio.flush()
        with self.path.open("rb") as stream:
            self._checksum = _crc_of(stream, self._counted, end, self._checksum)
        self._counted = end


class ChecksummedWriter(Writer):
    """A writer of bags whose MCAP files carry checksums."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChecksummedMcap})
