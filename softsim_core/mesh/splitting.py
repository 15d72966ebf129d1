"""Conforming tetrahedra of hexahedra, wedges and pyramids."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError

FACES: Mapping[str, tuple[tuple[int, ...], ...]] = {
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
"""Faces of each kind of cell that can be split, by VTK's numbers of its nodes, all turned the same way."""

_TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
_FLAT = 1.0e-12  # six times the volume of a part over the cube of the cell's size: below it, it is round-off


def split_cells(
    points: Array, tets: IndexArray, cells: Mapping[str, IndexArray], file: Path
) -> tuple[Array, dict[str, tuple[IndexArray, IndexArray]]]:
    """Split cells into tetrahedra that share whole faces with their neighbours.

    The diagonal of a quadrilateral face is that of two triangles beside it, where there are some, and else
    begins at the node of the smallest number. A cell is the cone over its faces from a node at which all
    diagonals of its own faces meet, or, where there is none, from a new node at its centre. Cells with
    several corners in one node (a wedge written as a hexahedron) become fewer tetrahedra.

    Args:
        points: Node positions, shape (n, 3).
        tets: Linear tetrahedra of the same mesh, shape (m, 4); may be empty.
        cells: Node indices by kind, a key of `FACES`, in VTK's order.
        file: Where the mesh came from, for messages.

    Returns:
        The points with new centres behind them, and of each kind its tetrahedra, shape (k, 4), and the cell
        that each is a part of, shape (k,).

    Raises:
        MeshError: a cell is folded, so that a part of it has no or a negative volume.

    Source: Dompierre, Labbé, Vallet, Camarero, How to subdivide pyramids, prisms, and hexahedra into
        tetrahedra, 1999.
    """
    triangles = [tets[:, _TET_FACES].reshape(-1, 3)]
    triangles += [block[:, face] for kind, block in cells.items() for face in FACES[kind] if len(face) == 3]
    beside = {tuple(face) for face in np.sort(np.concatenate(triangles), axis=1).tolist()}
    centres: list[Array] = []
    parts: dict[str, tuple[IndexArray, IndexArray]] = {}
    for kind, block in cells.items():
        rows: list[tuple[int, ...]] = []
        owners: list[int] = []
        for number, cell in enumerate(block.tolist()):
            faces = [[cell[corner] for corner in face] for face in FACES[kind]]
            halves = [_triangles(face, beside) for face in faces]
            apex = next(_apexes(faces, halves), None)
            if apex is None:
                apex = len(points) + len(centres)
                centres.append(points[np.unique(cell)].mean(axis=0))
            rows += [(*half, apex) for both in halves for half in both if apex not in half]
            owners += [number] * (len(rows) - len(owners))
        parts[kind] = (np.array(rows, dtype=np.int64).reshape(-1, 4), np.array(owners, dtype=np.int64))
    if centres:
        points = np.concatenate([points, centres])
    for kind, (split, whole) in parts.items():
        _refuse_folded(points, split, whole, kind, cells[kind], file)
    return points, parts


def _triangles(face: list[int], beside: set[tuple[int, ...]]) -> list[tuple[int, int, int]]:
    """Return the triangles of a face with three or four corners, without those that use a node twice."""
    if len(face) == 3:
        halves = [(face[0], face[1], face[2])]
    else:
        a, b, c, d = face
        from_a, from_b = [(a, b, c), (a, c, d)], [(a, b, d), (b, c, d)]
        if any(tuple(sorted(half)) in beside for half in from_a):
            halves = from_a
        elif any(tuple(sorted(half)) in beside for half in from_b):
            halves = from_b
        else:
            halves = from_a if min(face) in (a, c) else from_b
    return [half for half in halves if len(set(half)) == 3]


def _apexes(faces: list[list[int]], halves: list[list[tuple[int, int, int]]]) -> Iterator[int]:
    """Nodes of a cell, smallest first, that are in all triangles of each face that they are in."""
    for node in sorted({node for face in faces for node in face}):
        own = (both for face, both in zip(faces, halves, strict=True) if node in face)
        if all(node in half for both in own for half in both):
            yield node


def _refuse_folded(
    points: Array, rows: IndexArray, owners: IndexArray, kind: str, block: IndexArray, file: Path
) -> None:
    """Refuse cells whose parts do not all have a volume of the same sign."""
    corners = points[rows]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    size = np.ptp(points[block], axis=1).max(axis=1)
    signs = np.where(np.abs(volumes) > _FLAT * size[owners] ** 3, np.sign(volumes), 0.0)
    total = np.zeros(len(block))
    np.add.at(total, owners, volumes)
    folded = np.unique(owners[signs != np.sign(total)[owners]])
    empty = np.setdiff1d(np.arange(len(block)), owners)
    bad = np.union1d(folded, empty)
    if len(bad):
        raise MeshError(
            file,
            f"{len(bad)} of {len(block)} cells of kind {kind} are folded or have no volume, the first is "
            f"number {bad[0]} with nodes {block[bad[0]].tolist()} (counted from 0); mesh the part again, or "
            "export tetrahedra",
        )
