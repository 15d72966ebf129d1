"""VTU files by meshio's reader, with a bound on what their compressed arrays unpack to."""

from __future__ import annotations

import base64
import importlib
import lzma
import re
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.errors import MeshError

MOST_UNPACKED: Final = 1 << 30
"""All arrays of a file together unpack to at most so many bytes."""
RATIO, FREE = 100, 64 << 20
"""They also unpack to at most RATIO times the file's size and FREE bytes: meshes compress less than that."""
_PER_POINT, _PER_CELL = 9 * 8, 256 * 8
"""An array has at most so many bytes per declared point (a tensor), or per declared cell (its nodes)."""
_MOST_DICTIONARY: Final = 1 << 28
_COUNT = re.compile(rb"\bNumberOf(Points|Cells)\s*=\s*[\"']\s*(\d{1,18})\b")


def read_vtu(file: Path, data: bytes) -> Any:
    """Return meshio's mesh of a VTU file.

    Args:
        file: The file.
        data: What it holds.

    Raises:
        MeshError: its arrays unpack to more than it declares, or than is allowed.
        Exception: meshio's own, where it is damaged.
    """
    module: Any = importlib.import_module("meshio.vtu._vtu")
    allowance = _Allowance(file, data)

    def unpacked(reader: Any, text: str, dtype: Any) -> Any:
        order = "<" if reader.byte_order == "LittleEndian" else ">" if reader.byte_order else "="
        header = module.vtu_to_numpy_type[reader.header_type].newbyteorder(order)
        blocks = _blocks(text, header, _DECOMPRESSORS[reader.compression], allowance)
        return np.frombuffer(blocks, dtype=dtype.newbyteorder(order))

    bounded = type("BoundedVtuReader", (module.VtuReader,), {"read_compressed_binary": unpacked})
    found = bounded(str(file))
    return importlib.import_module("meshio").Mesh(
        found.points,
        found.cells,
        point_data=found.point_data,
        cell_data=found.cell_data,
        field_data=found.field_data,
    )


class _Allowance:
    """How much the arrays of a file may still unpack to.

    Args:
        file: The file.
        data: What it holds.
    """

    def __init__(self, file: Path, data: bytes) -> None:
        self._file = file
        declared = {b"Points": 0, b"Cells": 0}
        for kind, count in _COUNT.findall(data):
            declared[kind] += int(count)
        self._points, self._cells = declared[b"Points"], declared[b"Cells"]
        self._each = max(_PER_POINT * self._points, _PER_CELL * self._cells)
        self._left = self._all = min(MOST_UNPACKED, RATIO * len(data) + FREE)

    def unpack(self, packed: bytes, decompressor: Any, before: int) -> bytes:
        """Unpack a block of an array that has `before` bytes already; never more than is allowed.

        Raises:
            MeshError: it is larger.
        """
        most = min(self._each - before, self._left)
        block = bytes(decompressor.decompress(packed, most + 1))
        if len(block) > most:
            raise MeshError(
                self._file,
                f"holds compressed arrays of more than {min(self._each, self._all):,} bytes, more than its "
                f"{self._points} points and {self._cells} cells or its size allow; it is damaged; export the "
                "mesh again, without compression if it is good",
            )
        if not decompressor.eof:
            raise ValueError("a compressed block is cut off")
        self._left -= len(block)
        return block


_DECOMPRESSORS: Final = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lambda: lzma.LZMADecompressor(memlimit=_MOST_DICTIONARY),
}


def _blocks(text: str, header: Any, decompressor: Any, allowance: _Allowance) -> bytes:
    """Unpack an array: base64 of its header (counts, then sizes of its blocks), then base64 of the blocks."""
    size = header.itemsize
    count = int(np.frombuffer(base64.b64decode(text[: _characters(size)])[:size], header)[0])
    start = _characters(size * (3 + count))
    if start > len(text):
        raise ValueError(f"an array declares {count} blocks and is shorter than their sizes")
    sizes = np.frombuffer(base64.b64decode(text[:start]), header)[3 : 3 + count].astype(np.int64)
    ends = np.cumsum(sizes)
    total = int(ends[-1]) if count else 0
    packed = base64.b64decode(text[start : start + _characters(total)])
    if (sizes < 0).any() or len(packed) < total:
        raise ValueError(f"an array declares {total} compressed bytes and holds {len(packed)}")
    found = bytearray()
    for end, length in zip(ends.tolist(), sizes.tolist(), strict=True):
        found += allowance.unpack(packed[end - length : end], decompressor(), len(found))
    return bytes(found)


def _characters(count: int) -> int:
    """Length of the base64 text of so many bytes."""
    return -(-count // 3) * 4
