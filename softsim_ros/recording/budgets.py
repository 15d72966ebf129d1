"""How much a bag may unpack to: bounds that are held before memory is spent, whoever wrote the bag.

The reader unpacks what a file says. Here its decompressors are replaced by ones that stop at the size that
the chunk announces; chunks and bags that announce too much are refused before they are read, and so are
bags that are compressed as a whole, which the reader would unpack to the disk without end.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Final

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag2 import ReaderError, reader, storage_mcap

from softsim_ros.recording.checksums import read_data_section, read_summary
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.torn_files import FOOTER, MAGIC

MOST_CHUNK_BYTES: Final = 128 * 2**20
"""A chunk may unpack to so many bytes; a recorder's are of about one MiB."""

MOST_BAG_BYTES: Final = 64 * 2**30
"""All chunks together may unpack to so many bytes."""

MOST_TIMES: Final = 1000
"""So many times its own size a file may unpack to, beyond the size of one chunk."""

MOST_METADATA_BYTES: Final = 8 * 2**20
CHUNK: Final = 0x06
_HEAD: Final = struct.Struct("<BQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQI")


def hold_budget(path: Path) -> None:
    """Refuse a bag (a folder or one storage file) that unpacks to too much or does not match its checksums.

    Every byte is read, at the pace of the disk: the bytes between chunks have no other checksum.

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
    """What all chunks of a file say that they unpack to, as far as its records are whole."""
    size, total = file.stat().st_size, 0
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return 0  # the reader says so
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            kind, length = _HEAD.unpack(head)
            begin = stream.tell()
            if kind == FOOTER or begin + length > size:
                break
            if kind == CHUNK:
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
            stream.seek(begin + length)
    if total > MOST_TIMES * size + MOST_CHUNK_BYTES:
        raise BagError(path, f"is refused: it would unpack to {total // size} times its size")
    return total


def _check_sums(path: Path, file: Path) -> None:
    """Compare what stands before and in the index of a file with their checksums, where it has them."""
    with file.open("rb") as stream:
        summary, data = read_summary(stream), read_data_section(stream)
    if summary is not None and summary.told not in (0, summary.counted):
        raise BagError(path, "is damaged: the index at its end does not match its checksum")
    if data is not None and data.told not in (0, data.counted):
        raise BagError(path, "is damaged: its data do not match their checksum (bits have changed since)")


def _zstd(data: bytes, size: int) -> bytes:
    module: Any = storage_mcap
    return _bounded(module.zstd.ZstdDecompressor(), data, size)


def _lz4(data: bytes, size: int) -> bytes:
    return _bounded(LZ4FrameDecompressor(), data, size)


def _bounded(decompressor: Any, data: bytes, size: int) -> bytes:
    """What data unpack to, never more than one byte beyond `size`."""
    if size > MOST_CHUNK_BYTES:
        raise ReaderError(f"a chunk would unpack to {size} bytes")
    try:
        return bytes(decompressor.decompress(data, max_length=size + 1))
    except Exception as error:
        raise ReaderError(f"a chunk cannot be unpacked ({error})") from error


class _NoWholeFiles:
    """Takes the place of the compression module where the reader unpacks what no chunk bounds."""

    @staticmethod
    def open(*_: object, **__: object) -> None:
        raise ReaderError("it is compressed as a whole file; unpack it with: zstd -d")

    @staticmethod
    def decompress(*_: object, **__: object) -> bytes:
        raise ReaderError("it is compressed message by message; convert it with: ros2 bag convert")


def guard_reader() -> None:
    """Put the bounds into the reader; a second call changes nothing."""
    storage_mcap.DECOMPRESSORS.update(zstd=_zstd, lz4=_lz4)
    module: Any = reader
    module.zstd = _NoWholeFiles
