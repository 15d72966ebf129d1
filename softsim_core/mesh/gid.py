"""GiD text meshes (.gidmsh, .msh), which meshio does not know."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError

_CORNERS = {"linear": 2, "triangle": 3, "quadrilateral": 4, "tetrahedra": 4, "hexahedra": 8}
_Lines = Iterator[tuple[int, list[str]]]


def is_gid(data: bytes) -> bool:
    """Whether text begins like a GiD mesh: the first line that is no comment has MESH and dimension."""
    for line in data[:4096].splitlines():
        words = line.split()
        if words and not words[0].startswith(b"#"):
            return words[0].upper() == b"MESH" and b"dimension" in line.lower()
    return False


def parse_gid(data: bytes, path: Path) -> tuple[Array, dict[str, IndexArray]]:
    """Points and elements of a GiD text mesh; node numbers of the file become 0-based rows.

    Args:
        data: The file's bytes.
        path: Its name, for messages.

    Returns:
        Points in file units, shape (n, 3), in file order, and for each kind of element ("tetrahedra",
        "triangle", ...) its indices in file order.

    Raises:
        MeshError: names the line and what was expected there.
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
            ids.append(_integer(values[0], line, path))
            rows.append([_number(value, line, path) for value in values[1:]] + [0.0] * (3 - dimension))
        _expect(lines, "elements", path)
        found = elements.setdefault(kind, [])
        for line, values in _block(lines, "elements", path):
            if len(values) not in (1 + per_element, 2 + per_element):  # a last number names the material
                raise MeshError(
                    path, f"line {line}: an element of {kind} needs a number and {per_element} nodes"
                )
            found.append([_integer(value, line, path) for value in values[1 : 1 + _CORNERS[kind]]])
    if not rows:
        raise MeshError(
            path, "holds no nodes; a GiD mesh begins with MESH dimension 3 ElemType Tetrahedra Nnode 4"
        )
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return points, {
        kind: _renumbered(np.array(ids), found, kind, path) for kind, found in elements.items() if found
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


def _integer(word: str, line: int, path: Path) -> int:
    try:
        return int(word)
    except ValueError:
        raise MeshError(path, f"line {line}: {word!r} is not a whole number") from None


def _number(word: str, line: int, path: Path) -> float:
    try:
        return float(word)
    except ValueError:
        raise MeshError(path, f"line {line}: {word!r} is not a number") from None


def _renumbered(ids: IndexArray, elements: list[list[int]], kind: str, path: Path) -> IndexArray:
    wanted = np.array(elements, dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    if (np.diff(ids[order]) == 0).any():
        raise MeshError(path, f"node number {ids[order][:-1][np.diff(ids[order]) == 0][0]} occurs twice")
    place = np.minimum(np.searchsorted(ids[order], wanted), len(ids) - 1)
    missing = np.argwhere(ids[order][place] != wanted)
    if len(missing):
        element, corner = missing[0]
        raise MeshError(
            path,
            f"{len(np.unique(missing[:, 0]))} of {len(wanted)} {kind} name a node that is not in the file, "
            f"the first is element {element + 1} with node {wanted[element, corner]}",
        )
    return np.ascontiguousarray(order[place], dtype=np.int64)
