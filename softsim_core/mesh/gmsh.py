"""Gmsh files of format 4.1, text and binary, with all physical groups that their entities are in.

Source: the Gmsh reference manual, section "MSH file format version 4.1".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError

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


@dataclass(frozen=True, slots=True)
class GmshBlock:
    """Elements of one kind of one entity.

    Attributes:
        kind: Name of the kind, as meshio has it.
        dimension: Of the entity: 0 for points to 3 for volumes.
        cells: Indices of their nodes, in the order of this suite, shape (k, nodes).
        groups: Names of the physical groups that the entity is in, or else their numbers.
    """

    kind: str
    dimension: int
    cells: IndexArray
    groups: tuple[str, ...]


@dataclass(slots=True)
class _Parts:
    """What was read so far: names of groups, groups of entities, nodes, elements."""

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    groups: dict[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    tags: list[IndexArray] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    elements: list[tuple[int, int, int, IndexArray]] = field(default_factory=list)


class _Numbers:
    """The numbers of a section one after the other, from text or from bytes."""

    def __init__(self, data: bytes, start: int, end: int, order: str | None) -> None:
        self._order, self._data, self._at = order, data, start
        if order is None:
            self._text, self._at = np.array(data[start:end].split()).astype(np.float64), 0

    def take(self, kind: str, count: int) -> Array:
        """The next `count` numbers, shape (count,)."""
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
        """Where bytes were read to; 0 of text."""
        return 0 if self._order is None else self._at

    def whole(self, kind: str, count: int) -> list[int]:
        """The same as whole numbers."""
        return [int(each) for each in self.take(kind, count)]


def is_gmsh_41(data: bytes) -> bool:
    """Whether a .msh file is of this format."""
    return re.match(rb"\s*\$MeshFormat\s+4\.1\s", data) is not None


def parse_gmsh(data: bytes, file: Path) -> tuple[Array, list[GmshBlock]]:
    """Points in file units, shape (n, 3), and elements of a file of format 4.1.

    Raises:
        MeshError: a section is missing, an element is of a kind that is not known or names no node of it.
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


def _blocks(parts: _Parts, file: Path) -> Iterator[GmshBlock]:
    """Elements with indices of nodes in the place of Gmsh's tags."""
    tags = np.concatenate(parts.tags)
    order = np.argsort(tags)
    for dimension, tag, kind, cells in parts.elements:
        place = np.searchsorted(tags, cells, sorter=order)
        if (place >= len(tags)).any() or (tags[order[np.minimum(place, len(tags) - 1)]] != cells).any():
            raise MeshError(file, "holds an element with a node that is not in it; the file is damaged")
        found = order[place]
        if kind == 11:
            found = found[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]  # Gmsh has the last two edges the other way
        groups = (
            parts.names.get((dimension, abs(each)), str(abs(each)))
            for each in parts.groups.get((dimension, tag), ())
        )
        yield GmshBlock(_KINDS[kind][0], dimension, found, tuple(dict.fromkeys(groups)))
