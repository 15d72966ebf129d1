"""MCAP files whose writer died: where their last whole record ends, and an end after it.

An MCAP file is a magic number, records (one byte of kind, eight of length, the content), and the magic number
again. A file without the closing part cannot be opened; with it, and no index, it can.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from softsim_core.file_writing import open_in_place
from softsim_ros.recording.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
DATA_END, FOOTER = 0x0F, 0x02
_HEAD = struct.Struct("<BQ")


def is_torn(file: Path) -> bool:
    """Whether the file begins as an MCAP file but does not end as one."""
    with file.open("rb") as stream:
        begins = stream.read(len(MAGIC)) == MAGIC
        size = stream.seek(0, 2)
        stream.seek(max(size - len(MAGIC), 0))
        return begins and (size < 2 * len(MAGIC) or stream.read() != MAGIC)


def end_torn_file(file: Path) -> None:
    """Cut a torn file after its last whole record before the summary, and close it without an index.

    Raises:
        BagError: it is no MCAP file.
        OSError: it cannot be written.
    """
    with open_in_place(file, "r+b") as stream:
        end = _sound_length(stream)
        if end <= len(MAGIC):
            raise BagError(file, "is not an MCAP file, or was cut before its first record; nothing to save")
        stream.truncate(end)
        stream.seek(end)
        stream.write(_HEAD.pack(DATA_END, 4) + bytes(4))
        stream.write(_HEAD.pack(FOOTER, 20) + bytes(20))
        stream.write(MAGIC)


def _sound_length(stream: BinaryIO) -> int:
    """Bytes up to the end of the last whole data record; 0 for a file of another kind."""
    if stream.read(len(MAGIC)) != MAGIC:
        return 0
    size = stream.seek(0, 2)
    end = stream.seek(len(MAGIC))
    while True:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return end
        kind, length = _HEAD.unpack(head)
        if kind in (DATA_END, FOOTER) or end + _HEAD.size + length > size:
            return end
        end = stream.seek(length, 1)
