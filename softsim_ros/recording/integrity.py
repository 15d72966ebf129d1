"""Integrity of bags: torn ends, bounds on their unpacked size, CRC-32 of their parts.

An MCAP file is a magic number, records (one byte of kind, eight of length, the content), and the magic number
again. A file without the closing part cannot be opened; with it, and no index, it can.

The reader itself unpacks whatever a file contains. Here its decompressors are replaced by ones that stop at
the size that the chunk announces. Chunks and bags that announce too much are refused before they are read.
Bags that are compressed as a whole are refused too, because the reader would unpack them to the disk without
limit.
"""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Final

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag2 import ReaderError, StoragePlugin, Writer, reader, storage_mcap
from rosbags.rosbag2.storage_mcap import McapWriter

from softsim_core.base import open_in_place
from softsim_ros.recording.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
DATA_END, FOOTER = 0x0F, 0x02
_HEAD: Final = struct.Struct("<BQ")


def is_torn(file: Path) -> bool:
    """Return whether the file begins as an MCAP file but does not end as one."""
    with file.open("rb") as stream:
        begins = stream.read(len(MAGIC)) == MAGIC
        size = stream.seek(0, 2)
        stream.seek(max(size - len(MAGIC), 0))
        return begins and (size < 2 * len(MAGIC) or stream.read() != MAGIC)


def end_torn_file(file: Path) -> None:
    """Truncate a torn file after its last whole record before the summary, and close it without an index.

    Raises:
        BagError: it is no MCAP file.
        OSError: it cannot be written.
    """
    with open_in_place(file, "r+b") as stream:
        end = 0
        for _, begin, length in _whole_records(stream, DATA_END, FOOTER):
            end = begin + length
        if not end:
            raise BagError(file, "is not an MCAP file, or was cut before its first record; nothing to save")
        stream.truncate(end)
        stream.seek(end)
        stream.write(_HEAD.pack(DATA_END, 4) + bytes(4))
        stream.write(_HEAD.pack(FOOTER, 20) + bytes(20))
        stream.write(MAGIC)


def _whole_records(stream: BinaryIO, *ends: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and length of each record, up to one of the kinds `ends` or one that is cut off.

    A file of another format has none. The begin is that of the content, at which the stream stands.
    """
    size = stream.seek(0, 2)
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        return
    while len(head := stream.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        begin = stream.tell()
        if kind in ends or begin + length > size:
            return
        yield kind, begin, length
        stream.seek(begin + length)


CRC_OFFSET: Final = 9 + 24
"""Offset of the checksum in a chunk: after the record's head, two times and the unpacked size."""

BLOCK_BYTES: Final = 2**20
"""Number of bytes of a file that are read at once."""

_FOOTER: Final = struct.Struct("<QQI")
_DATA_END: Final = struct.Struct("<BQI")


def _footer(stream: BinaryIO) -> tuple[int, int, int]:
    """Return begin of the index, end of the footer after it, and checksum of the index.

    Return 0, 0, 0 if there is none.
    """
    end = stream.seek(0, 2) - len(MAGIC)
    if end < _FOOTER.size:
        return 0, 0, 0
    stream.seek(end - _FOOTER.size)
    begin, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
    return (begin, end, checksum) if 0 < begin <= end - _FOOTER.size else (0, 0, 0)


def _crc_of(stream: BinaryIO, begin: int, end: int, before: int = 0) -> int:
    """Return the CRC-32 of the bytes from `begin` to `end`, continued from the CRC-32 `before`."""
    stream.seek(begin)
    for at in range(begin, end, BLOCK_BYTES):
        before = crc32(stream.read(min(BLOCK_BYTES, end - at)), before)
    return before


class ChecksummedMcap(McapWriter):
    """An MCAP file with checksums, which the base class leaves out."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._counted, self._checksum = 0, 0  # number of checksummed bytes, and their checksum

    def close_chunk(self) -> None:
        """Write the pending chunk with its checksum."""
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
        """Extend the checksum of the data to the byte `end`; these bytes are still in the system's cache."""
        if not self.bio.closed:
            self.bio.flush()
        with self.path.open("rb") as stream:
            self._checksum = _crc_of(stream, self._counted, end, self._checksum)
        self._counted = end


class ChecksummedWriter(Writer):
    """A writer of bags with checksums in their MCAP files."""

    STORAGE_PLUGINS = MappingProxyType({**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: ChecksummedMcap})


MOST_CHUNK_BYTES: Final = 128 * 2**20
"""Largest unpacked size of a chunk in bytes; a recorder's chunks have about one MiB."""

MOST_BAG_BYTES: Final = 64 * 2**30
"""Largest unpacked size of all chunks together in bytes."""

MOST_TIMES: Final = 1000
"""Largest unpacked size of a file as a multiple of its own size, beyond the size of one chunk."""

MOST_METADATA_BYTES: Final = 8 * 2**20
CHUNK: Final = 0x06
_CHUNK_HEAD: Final = struct.Struct("<QQQI")


def hold_budget(path: Path) -> None:
    """Refuse a bag (a folder or one storage file) that unpacks to too much or does not match its checksums.

    Every byte is read at the speed of the disk, because the bytes between chunks have no other checksum.

    Raises:
        BagError: says what is too large or damaged.
    """
    metadata = path / "metadata.yaml"
    if metadata.is_file() and metadata.stat().st_size > MOST_METADATA_BYTES:
        raise BagError(path, f"is refused: its metadata.yaml is larger than {MOST_METADATA_BYTES >> 20} MiB")
    total = 0
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        if file.suffix == ".mcap":
            total += _unpacked_bytes(path, file)
            _check_sums(path, file)
    if total > MOST_BAG_BYTES:
        raise BagError(path, f"is refused: it would unpack to more than {MOST_BAG_BYTES >> 30} GiB")


def _unpacked_bytes(path: Path, file: Path) -> int:
    """Return the unpacked size that all chunks of a file announce, as far as its records are whole."""
    size, total = file.stat().st_size, 0
    with file.open("rb") as stream:
        for kind, _, length in _whole_records(stream, FOOTER):
            if kind != CHUNK:
                continue
            if length < _CHUNK_HEAD.size:
                raise BagError(path, f"is damaged (a chunk of {length} bytes)")
            unpacked = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))[2]
            if unpacked > MOST_CHUNK_BYTES:
                raise BagError(
                    path,
                    f"is refused: a chunk of {length} bytes would unpack to {unpacked >> 20} MiB, "
                    f"at most {MOST_CHUNK_BYTES >> 20} are read",
                )
            total += unpacked
    if total > MOST_TIMES * size + MOST_CHUNK_BYTES:
        raise BagError(path, f"is refused: it would unpack to {total // size} times its size")
    return total


def _check_sums(path: Path, file: Path) -> None:
    """Compare the index of a file and everything before it with their checksums; 0 stands for none."""
    with file.open("rb") as stream:
        begin, end, stored = _footer(stream)
        if stored and stored != _crc_of(stream, begin, end - 4):
            raise BagError(path, "is damaged: the index at its end does not match its checksum")
        end_of_data = begin - _DATA_END.size
        if end_of_data < 0:
            return
        stream.seek(end_of_data)
        kind, length, stored = _DATA_END.unpack(stream.read(_DATA_END.size))
        if (kind, length) == (DATA_END, 4) and stored and stored != _crc_of(stream, 0, end_of_data):
            raise BagError(path, "is damaged: its data do not match their checksum (bits have changed since)")


def _unpack_bounded(decompressor: Callable[[], Any], data: bytes, size: int) -> bytes:
    """Return unpacked data, at most one byte more than `size`."""
    if size > MOST_CHUNK_BYTES:
        raise ReaderError(f"a chunk would unpack to {size} bytes")
    try:
        return bytes(decompressor().decompress(data, max_length=size + 1))
    except Exception as error:
        raise ReaderError(f"a chunk cannot be unpacked ({error})") from error


class _NoWholeFiles:
    """Replaces the compression module in the reader for data that no chunk bounds."""

    @staticmethod
    def open(*_: object, **__: object) -> None:
        raise ReaderError("it is compressed as a whole file; unpack it with: zstd -d")

    @staticmethod
    def decompress(*_: object, **__: object) -> bytes:
        raise ReaderError("it is compressed message by message; convert it with: ros2 bag convert")


def guard_reader() -> None:
    """Install the bounds in the reader; a second call changes nothing."""
    mcap: Any = storage_mcap
    bag: Any = reader
    mcap.DECOMPRESSORS["zstd"] = partial(_unpack_bounded, mcap.zstd.ZstdDecompressor)
    mcap.DECOMPRESSORS["lz4"] = partial(_unpack_bounded, LZ4FrameDecompressor)
    bag.zstd = _NoWholeFiles
