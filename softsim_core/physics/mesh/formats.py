"""Readers of single mesh formats: STL and OBJ, GiD, Gmsh 4.1, VTU.

meshio reads STL only with lower-case keywords and LF line ends and reads a truncated binary file as text; of
OBJ files it refuses the common case of texture coordinates that do not match the vertices one to one.

Source: the Gmsh reference manual, section "MSH file format version 4.1".
"""

from __future__ import annotations

import base64
import importlib
import itertools
import lzma
import re
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import DTypeLike

from softsim_core.base import Array, IndexArray, MeshError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_WORDS = ("solid", "facet", "outer", "endloop", "endfacet", "endsolid")


def parse_stl(data: bytes, path: Path) -> tuple[Array, IndexArray]:
    """Return vertices and triangles of an STL file; corners at exactly the same position are merged.

    A file that is long enough for its triangle count is binary, whatever its header says: the first four
    letters of a text, read as a count, exceed 10^8 triangles. Any other must be text beginning with "solid".
    Normals, attribute bytes and data after the last triangle are not used.

    Returns:
        Points in file units, shape (n, 3), in order of first appearance, and triangles, shape (k, 3).

    Raises:
        MeshError: the file is neither, or is truncated.
    """
    count = int.from_bytes(data[80:84], "little")
    if 84 + _FACET.itemsize * count <= len(data):
        corners = np.frombuffer(data, _FACET, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    elif data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data[:512]:
        corners = _text_corners(data, path)
    elif len(data) < 84:
        raise MeshError(path, f"{len(data)} bytes are too few for binary STL, and text STL begins with solid")
    else:
        raise MeshError(
            path,
            f"binary STL of {count} triangles needs {84 + _FACET.itemsize * count} bytes, not {len(data)}; "
            "it is damaged or cut off (text STL would begin with solid)",
        )
    return merge_corners(corners)


def parse_obj(data: bytes, path: Path) -> tuple[Array, IndexArray]:
    """Return vertices and triangles of an OBJ file; faces with more corners are split into fans.

    Returns:
        Points in file units, shape (n, 3), and triangles, shape (k, 3).

    Raises:
        MeshError: names the line and the expected content.
    """
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    text = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = (float(word) for word in words[1:4])
                points.append([x, y, z])
                continue
            corners = [int(word.split("/")[0]) for word in words[1:]]
        except ValueError:
            raise MeshError(
                path, f"line {number}: {line.strip()!r} is no vertex (v x y z) and no face (f i j k)"
            ) from None
        if len(corners) < 3 or 0 in corners:
            raise MeshError(path, f"line {number}: a face needs at least 3 vertex numbers, counted from 1")
        first, *rest = (corner - 1 if corner > 0 else len(points) + corner for corner in corners)
        triangles.extend((first, second, third) for second, third in itertools.pairwise(rest))
    return np.array(points, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(
        -1, 3
    )


def merge_corners(corners: Array) -> tuple[Array, IndexArray]:
    """Return distinct points (n, 3), in order of appearance, and triangles (k, 3) of corners (3 k, 3)."""
    corners = corners + 0.0  # -0.0 becomes 0.0
    if not len(corners):
        return corners.reshape(0, 3), np.empty((0, 3), dtype=np.int64)
    _, first, inverse = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3).astype(np.int64)


def drop_degenerate(triangles: IndexArray, path: Path) -> IndexArray:
    """Return triangles without those that use a vertex twice; warns if there are any."""
    a, b, c = triangles.T
    degenerate = (a == b) | (b == c) | (c == a)
    if degenerate.any():
        warnings.warn(
            f"mesh {path}: {degenerate.sum()} of {len(triangles)} triangles with two equal corners dropped",
            stacklevel=3,
        )
    return np.asarray(triangles[~degenerate])


def _text_corners(data: bytes, path: Path) -> Array:
    corners: list[list[float]] = []
    word, number = "", 0
    for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        word = words[0].lower()
        if word == "vertex":
            try:
                x, y, z = (float(value) for value in words[1:])
            except ValueError:
                raise MeshError(
                    path, f"line {number}: a vertex needs three numbers, not {line.strip()!r}"
                ) from None
            corners.append([x, y, z])
        elif word not in _STL_WORDS:
            raise MeshError(path, f"line {number}: {words[0]!r} is no word of a text STL file")
        elif word == "endfacet" and len(corners) % 3:
            raise MeshError(path, f"line {number}: a facet needs exactly 3 vertices")
    if word != "endsolid" or len(corners) % 3:
        raise MeshError(path, f"ends at line {number} without endsolid; the file is cut off")
    return np.array(corners, dtype=np.float64).reshape(-1, 3)


_CORNERS = {"linear": 2, "triangle": 3, "quadrilateral": 4, "tetrahedra": 4, "hexahedra": 8}
_Lines = Iterator[tuple[int, list[str]]]
T = TypeVar("T", int, float)


def is_gid(data: bytes) -> bool:
    """Return whether the first line of a text that is not a comment has MESH and dimension, as in GiD."""
    for line in data[:4096].splitlines():
        words = line.split()
        if words and not words[0].startswith(b"#"):
            return words[0].upper() == b"MESH" and b"dimension" in line.lower()
    return False


def parse_gid(data: bytes, path: Path) -> tuple[Array, dict[str, IndexArray]]:
    """Return points and elements of a GiD text mesh; node numbers of the file become 0-based rows.

    Returns:
        Points in file units, shape (n, 3), in file order, and for each kind of element ("tetrahedra",
        "triangle", ...) its indices in file order.

    Raises:
        MeshError: names the line and the expected content.
    """
    text = data.decode("utf-8", errors="replace")
    lines: _Lines = (
        (number, words)
        for number, words in enumerate((line.split() for line in text.splitlines()), start=1)
        if words and not words[0].startswith("#")
    )
    ids: list[int] = []
    rows: list[list[float]] = []
    elements: dict[str, list[list[int]]] = {}
    for number, words in lines:
        kind, dimension, per_element = _header(words, number, path)
        _expect(lines, "coordinates", path)
        for line, values in _block(lines, "coordinates", path):
            if len(values) != 1 + dimension:
                raise MeshError(path, f"line {line}: a node needs a number and {dimension} coordinates")
            ids += _convert(int, values[:1], line, path)
            rows.append(_convert(float, values[1:], line, path) + [0.0] * (3 - dimension))
        _expect(lines, "elements", path)
        found = elements.setdefault(kind, [])
        for line, values in _block(lines, "elements", path):
            if len(values) not in (1 + per_element, 2 + per_element):  # the last number is the material
                raise MeshError(
                    path, f"line {line}: an element of {kind} needs a number and {per_element} nodes"
                )
            found.append(_convert(int, values[1 : 1 + _CORNERS[kind]], line, path))
    if not rows:
        raise MeshError(
            path, "holds no nodes; a GiD mesh begins with MESH dimension 3 ElemType Tetrahedra Nnode 4"
        )
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return points, {
        kind: _renumber_nodes(np.array(ids), found, kind, path) for kind, found in elements.items() if found
    }


def _header(words: list[str], number: int, path: Path) -> tuple[str, int, int]:
    lowered = [word.lower() for word in words]
    try:
        if lowered[0] != "mesh":
            raise ValueError
        dimension = int(words[lowered.index("dimension") + 1])
        kind = lowered[lowered.index("elemtype") + 1]
        per_element = int(words[lowered.index("nnode") + 1])
    except (ValueError, IndexError):
        raise MeshError(
            path, f"line {number}: expected a header like MESH dimension 3 ElemType Tetrahedra Nnode 4"
        ) from None
    if dimension not in (2, 3) or kind not in _CORNERS or per_element < _CORNERS[kind]:
        raise MeshError(
            path,
            f"line {number}: dimension {dimension}, {kind} with {per_element} nodes is not supported; "
            f"allowed are dimension 2 or 3 and {', '.join(_CORNERS)} with at least their corner nodes",
        )
    return kind, dimension, per_element


def _expect(lines: _Lines, keyword: str, path: Path) -> None:
    number, words = next(lines, (0, []))
    if " ".join(words).lower() != keyword:
        where = f"line {number}" if words else "the end of the file"
        raise MeshError(path, f"{where}: expected the keyword {keyword.capitalize()}")


def _block(lines: _Lines, keyword: str, path: Path) -> _Lines:
    for number, words in lines:
        if words[0].lower() == "end":
            if " ".join(words).lower() != f"end {keyword}":
                raise MeshError(path, f"line {number}: expected End {keyword.capitalize()}")
            return
        yield number, words
    raise MeshError(path, f"ends without End {keyword.capitalize()}; the file is cut off")


def _convert(to: type[T], words: list[str], line: int, path: Path) -> list[T]:
    numbers = []
    for word in words:
        try:
            numbers.append(to(word))
        except ValueError:
            kind = "whole number" if to is int else "number"
            raise MeshError(path, f"line {line}: {word!r} is not a {kind}") from None
    return numbers


def _renumber_nodes(ids: IndexArray, elements: list[list[int]], kind: str, path: Path) -> IndexArray:
    nodes = np.array(elements, dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    if (np.diff(ids[order]) == 0).any():
        raise MeshError(path, f"node number {ids[order][:-1][np.diff(ids[order]) == 0][0]} occurs twice")
    place = np.minimum(np.searchsorted(ids[order], nodes), len(ids) - 1)
    missing = np.argwhere(ids[order][place] != nodes)
    if len(missing):
        element, corner = missing[0]
        raise MeshError(
            path,
            f"{len(np.unique(missing[:, 0]))} of {len(nodes)} {kind} name a node that is not in the file, "
            f"the first is element {element + 1} with node {nodes[element, corner]}",
        )
    return np.ascontiguousarray(order[place], dtype=np.int64)


_KINDS = {
    1: ("line", 2),
    2: ("triangle", 3),
    3: ("quad", 4),
    4: ("tetra", 4),
    5: ("hexahedron", 8),
    6: ("wedge", 6),
    7: ("pyramid", 5),
    8: ("line3", 3),
    9: ("triangle6", 6),
    10: ("quad9", 9),
    11: ("tetra10", 10),
    12: ("hexahedron27", 27),
    15: ("vertex", 1),
    16: ("quad8", 8),
    17: ("hexahedron20", 20),
}
"""Names and numbers of nodes of Gmsh's types of elements."""
_INT, _SIZE, _DOUBLE = "i4", "i8", "f8"
Block = tuple[str, IndexArray, list[tuple[str, IndexArray]]]
"""Cells of one kind: its name in meshio, nodes (k, a) of each in the order of this package, and groups, by
name or else number, with the numbers of the cells in them.
"""


@dataclass(slots=True)
class _Parts:
    """Parsed parts of the file: names of groups, groups of entities, nodes, elements."""

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    groups: dict[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    tags: list[IndexArray] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    elements: list[tuple[int, int, int, IndexArray]] = field(default_factory=list)


class _Numbers:
    """The numbers of a section in order, from text or from bytes."""

    def __init__(self, data: bytes, start: int, end: int, order: str | None) -> None:
        self._order, self._data, self._at = order, data, start
        if order is None:
            self._text, self._at = np.array(data[start:end].split()).astype(np.float64), 0

    def take(self, kind: str, count: int) -> Array:
        """Return the next `count` numbers, shape (count,)."""
        if count < 0:
            raise ValueError("a negative number of entries")
        if self._order is None:
            found = self._text[self._at : self._at + count]
            self._at += count
        else:
            dtype: DTypeLike = np.dtype(self._order + kind)
            found = np.frombuffer(self._data, dtype, count, self._at).astype(np.float64)
            self._at += count * np.dtype(dtype).itemsize
        if len(found) != count:
            raise ValueError("it ends early")
        return found

    @property
    def end(self) -> int:
        """End of the bytes read so far; 0 for text."""
        return 0 if self._order is None else self._at

    def whole(self, kind: str, count: int) -> list[int]:
        """Return the next numbers as integers."""
        return [int(each) for each in self.take(kind, count)]


def is_gmsh_41(data: bytes) -> bool:
    """Return whether a .msh file has this format."""
    return re.match(rb"\s*\$MeshFormat\s+4\.1\s", data) is not None


def parse_gmsh(data: bytes, file: Path) -> tuple[Array, list[Block]]:
    """Return points in file units, shape (n, 3), and elements of a file of format 4.1, entity by entity.

    Raises:
        MeshError: a section is missing, or an element has an unknown kind or an unknown node.
        ValueError: a section ends early.
    """
    header = re.match(rb"\s*\$MeshFormat\s+4\.1\s+([01])\s+8[ \t]*\r?\n", data)
    if header is None:
        raise MeshError(file, "has a header of Gmsh 4.1 that names no file type 0 or 1 with sizes of 8 bytes")
    order = None
    if header[1] == b"1":
        order = "<" if data[header.end() : header.end() + 4] == b"\1\0\0\0" else ">"
    parts, at = _Parts(), header.end()
    while found := re.compile(rb"\$(\w+)[ \t]*\r?\n").search(data, at):
        name = found[1].decode()
        if name.startswith("End"):
            at = found.end()
            continue
        end = data.find(b"$End" + found[1], found.end())
        if end < 0:
            raise MeshError(file, f"ends without $End{name}; the file is cut off")
        read = {"Entities": _entities, "Nodes": _nodes, "Elements": _elements}.get(name)
        if name == "PhysicalNames":
            _names(data[found.end() : end].decode(errors="replace"), parts)
        elif read is not None:
            end = max(end, read(_Numbers(data, found.end(), end, order), parts, file))
        at = data.find(b"$End" + found[1], end)
        if at < 0:
            raise MeshError(file, f"ends without $End{name}; the file is cut off")
    if not parts.points or not parts.elements:
        raise MeshError(file, "has no nodes or no elements; generate the mesh before you save it")
    return np.concatenate(parts.points), list(_blocks(parts, file))


def _names(text: str, parts: _Parts) -> None:
    for line in text.splitlines():
        if named := re.match(r'\s*(\d+)\s+(\d+)\s+"(.*)"', line):
            parts.names[int(named[1]), int(named[2])] = named[3]


def _entities(numbers: _Numbers, parts: _Parts, file: Path) -> int:
    for dimension, count in enumerate(numbers.whole(_SIZE, 4)):
        for _ in range(count):
            (tag,) = numbers.whole(_INT, 1)
            numbers.take(_DOUBLE, 6 if dimension else 3)
            (physical,) = numbers.whole(_SIZE, 1)
            parts.groups[dimension, tag] = tuple(numbers.whole(_INT, physical))
            if dimension:
                (bounding,) = numbers.whole(_SIZE, 1)
                numbers.take(_INT, bounding)
    return numbers.end


def _nodes(numbers: _Numbers, parts: _Parts, file: Path) -> int:
    blocks, *_ = numbers.whole(_SIZE, 4)
    for _ in range(blocks):
        dimension, _, parametric = numbers.whole(_INT, 3)
        (count,) = numbers.whole(_SIZE, 1)
        parts.tags.append(numbers.take(_SIZE, count).astype(np.int64))
        width = 3 + dimension * bool(parametric)
        parts.points.append(numbers.take(_DOUBLE, count * width).reshape(-1, width)[:, :3])
    return numbers.end


def _elements(numbers: _Numbers, parts: _Parts, file: Path) -> int:
    blocks, *_ = numbers.whole(_SIZE, 4)
    for _ in range(blocks):
        dimension, tag, kind = numbers.whole(_INT, 3)
        (count,) = numbers.whole(_SIZE, 1)
        if kind not in _KINDS:
            raise MeshError(
                file, f"holds elements of Gmsh's type {kind}, which is not known; take order 1 or 2"
            )
        width = 1 + _KINDS[kind][1]
        rows = numbers.take(_SIZE, count * width).astype(np.int64).reshape(-1, width)
        parts.elements.append((dimension, tag, kind, rows[:, 1:]))
    return numbers.end


def _blocks(parts: _Parts, file: Path) -> Iterator[Block]:
    """Return the elements with indices of nodes instead of Gmsh's tags."""
    tags = np.concatenate(parts.tags)
    order = np.argsort(tags)
    for dimension, tag, kind, cells in parts.elements:
        place = np.searchsorted(tags, cells, sorter=order)
        if (place >= len(tags)).any() or (tags[order[np.minimum(place, len(tags) - 1)]] != cells).any():
            raise MeshError(file, "holds an element with a node that is not in it; the file is damaged")
        found = order[place]
        if kind == 11:
            found = found[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]  # Gmsh swaps the last two edges
        groups = map(abs, parts.groups.get((dimension, tag), ()))
        names = [parts.names.get((dimension, group), str(group)) for group in groups]
        yield _KINDS[kind][0], found, [(name, np.arange(len(found))) for name in dict.fromkeys(names)]


MOST_UNPACKED: Final = 1 << 30
"""Most bytes to which all arrays of a file together may unpack."""
RATIO, FREE = 100, 64 << 20
"""They also unpack to at most RATIO times the file's size plus FREE bytes; meshes compress less than that."""
_PER_POINT, _PER_CELL = 9 * 8, 256 * 8
"""Most bytes of an array per declared point (a tensor), or per declared cell (its nodes)."""
_MOST_DICTIONARY: Final = 1 << 28
_COUNT = re.compile(rb"\bNumberOf(Points|Cells)\s*=\s*[\"']\s*(\d{1,18})\b")


def read_vtu(file: Path, data: bytes) -> Any:
    """Return meshio's mesh of a VTU file.

    Args:
        file: The file.
        data: Its contents.

    Raises:
        MeshError: its arrays unpack to more than it declares, or than is allowed.
        Exception: meshio's own, if the file is damaged.
    """
    module: Any = importlib.import_module("meshio.vtu._vtu")
    allowance = _Allowance(file, data)

    def unpack(reader: Any, text: str, dtype: Any) -> Any:
        order = "<" if reader.byte_order == "LittleEndian" else ">" if reader.byte_order else "="
        header = module.vtu_to_numpy_type[reader.header_type].newbyteorder(order)
        blocks = _vtu_blocks(text, header, _DECOMPRESSORS[reader.compression], allowance)
        return np.frombuffer(blocks, dtype=dtype.newbyteorder(order))

    bounded = type("BoundedVtuReader", (module.VtuReader,), {"read_compressed_binary": unpack})
    found = bounded(str(file))
    return importlib.import_module("meshio").Mesh(
        found.points,
        found.cells,
        point_data=found.point_data,
        cell_data=found.cell_data,
        field_data=found.field_data,
    )


class _Allowance:
    """Number of bytes to which the arrays of a file may still unpack.

    Args:
        file: The file.
        data: Its contents.
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
        """Unpack a block of an array that already has `before` bytes, at most to the allowed size.

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


def _vtu_blocks(text: str, header: Any, decompressor: Any, allowance: _Allowance) -> bytes:
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
    """Return the length of the base64 text of a number of bytes."""
    return -(-count // 3) * 4
