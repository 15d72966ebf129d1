"""Generated meshes, and tetrahedra of hexahedra, wedges and pyramids."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from softsim_core.base import Array, IndexArray, MeshError, unique_pairs
from softsim_core.physics.mesh.types import TET_FACES, TETRAHEDRA, CellBlock, TetMesh

FACES: Mapping[str, tuple[tuple[int, ...], ...]] = {
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
"""Faces of each kind of cell that can be split, by VTK's numbers of its nodes, all oriented alike."""

_FLAT = 1.0e-12  # six times the volume of a part over the cube of the cell's size: below it, it is round-off


def split_cells(
    points: Array, tets: IndexArray, cells: Mapping[str, IndexArray], file: Path
) -> tuple[Array, dict[str, tuple[IndexArray, IndexArray]]]:
    """Split cells into tetrahedra that share whole faces with their neighbours.

    A quadrilateral face next to two triangles takes their diagonal; otherwise its diagonal starts at the node
    of the smallest number. A cell is the cone over its faces from a node at which all diagonals of its own
    faces meet or, without such a node, from a new node at its centre. Cells with several corners in one node
    (a wedge written as a hexahedron) become fewer tetrahedra.

    Args:
        points: Node positions, shape (n, 3).
        tets: Linear tetrahedra of the same mesh, shape (m, 4); may be empty.
        cells: Node indices by kind, a key of `FACES`, in VTK's order.
        file: Origin of the mesh, for messages.

    Returns:
        The points, with new centres after the others, and for each kind its tetrahedra, shape (k, 4), and the
        cell of each, shape (k,).

    Raises:
        MeshError: a cell is folded, so that a part of it has zero or negative volume.

    Source: Dompierre, Labbé, Vallet, Camarero, How to subdivide pyramids, prisms, and hexahedra into
        tetrahedra, 1999.
    """
    triangles = [tets[:, TET_FACES].reshape(-1, 3)]
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
            rows += [(apex, *half) for both in halves for half in both if apex not in half]
            owners += [number] * (len(rows) - len(owners))
        parts[kind] = (np.array(rows, dtype=np.int64).reshape(-1, 4), np.array(owners, dtype=np.int64))
    if centres:
        points = np.concatenate([points, centres])
    for kind, (split, whole) in parts.items():
        _refuse_folded(points, split, whole, kind, cells[kind], file)
    return points, parts


def cell_mesh(
    points: Array,
    tets: IndexArray,
    cells: Mapping[str, IndexArray],
    name: str | Path,
    groups: Mapping[str, Mapping[str, IndexArray]] | None = None,
) -> TetMesh:
    """Return a mesh of cells of several kinds, which are also split into tetrahedra.

    A cell that needs a new node at its centre, or has several corners in one node, is only tetrahedra.

    Args:
        points: Node positions in [m], shape (n, 3).
        tets: Tetrahedra, shape (m, 4) or, without other cells, (m, 10); may be empty.
        cells: Node indices by kind, a key of `FACES`, in VTK's order.
        name: Name of the mesh, for messages.
        groups: Cells by the name of their group and by their kind, as numbers among all of that kind.

    Returns:
        The mesh: the given tetrahedra, then those of the other cells.

    Raises:
        MeshError: see `split_cells`.
    """
    count, alone = len(points), len(tets)
    parts: dict[str, tuple[IndexArray, IndexArray]] = {}
    if cells:
        points, parts = split_cells(points, tets, cells, Path(name))
        tets = np.concatenate([tets, *(rows for rows, _ in parts.values())])
    owners = dict.fromkeys(("tetra", "tetra10"), _owner(len(tets), 0, np.arange(alone)))
    blocks, start = {}, alone
    for kind, (rows, own) in parts.items():
        owners[kind] = _owner(len(tets), start, own)
        start += len(rows)
        nodes = np.sort(cells[kind], axis=1)
        whole = (nodes[:, 1:] != nodes[:, :-1]).all(axis=1)
        whole[own[(rows >= count).any(axis=1)]] = False
        if whole.any():
            number = np.append(np.where(whole, np.cumsum(whole) - 1, -1), -1)
            blocks[kind] = CellBlock(np.ascontiguousarray(cells[kind][whole]), number[owners[kind]])
    named = {
        group: np.flatnonzero(np.any([np.isin(owners[kind], found[kind]) for kind in found], axis=0))
        for group, found in (groups or {}).items()
    }
    return TetMesh(points, np.ascontiguousarray(tets), str(name), cell_groups=named, blocks=blocks)


def whole_cells(mesh: TetMesh, kinds: Collection[str]) -> tuple[dict[str, IndexArray], IndexArray]:
    """Return the cells of a mesh by kind: those of some kinds whole, all others as tetrahedra.

    If a quadrilateral face of a whole cell belonged to two tetrahedra of another one, they would not fit each
    other; then all cells are tetrahedra.

    Args:
        mesh: The mesh.
        kinds: Kinds of `mesh.blocks`.

    Returns:
        Nodes of the cells by kind, shapes (k, a), first of the tetrahedra ("tetra" or "tetra10"), if there
        are any, and the cell that each tetrahedron of the mesh is or is a part of, counted through the kinds,
        shape (m,).
    """
    whole = {kind: block for kind, block in mesh.blocks.items() if kind in kinds}
    split = np.all([np.ones(len(mesh.tets), bool), *(block.owner < 0 for block in whole.values())], axis=0)
    if whole and split.any():
        beside = _face_numbers(mesh.tets[split][:, TET_FACES].reshape(-1, 3), len(mesh.points))
        for kind, block in whole.items():
            quads = np.array([face for face in FACES[kind] if len(face) == 4])
            halves = block.cells[:, quads[:, _HALVES]].reshape(-1, 3)
            if np.isin(_face_numbers(halves, len(mesh.points)), beside).any():
                return whole_cells(mesh, ())
    cells = {TETRAHEDRA[mesh.order]: mesh.tets[split]} if split.any() else {}
    cell_of_tet, count = np.cumsum(split) - 1, int(split.sum())
    for kind, block in whole.items():
        cells[kind] = block.cells
        cell_of_tet = np.where(block.owner < 0, cell_of_tet, count + block.owner)
        count += len(block.cells)
    return cells, cell_of_tet


_HALVES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]])
"""Corners of the triangles of a quadrilateral, for both of its diagonals."""


def _face_numbers(triangles: IndexArray, count: int) -> IndexArray:
    """Return a number of each triangle (k, 3) over `count` points, the same for any order of its corners."""
    first, second, third = np.sort(triangles, axis=1).astype(np.int64).T
    return np.asarray((first * count + second) * count + third)


def _owner(count: int, first: int, own: IndexArray) -> IndexArray:
    """Return the cell of each of `count` tetrahedra: those of `own` from the first one on, else -1."""
    owner = np.full(count, -1)
    owner[first : first + len(own)] = own
    return owner


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
    """Return the nodes of a cell that are in all triangles of each of their faces, smallest first."""
    for node in sorted({node for face in faces for node in face}):
        own = (both for face, both in zip(faces, halves, strict=True) if node in face)
        if all(node in half for both in own for half in both):
            yield node


def _refuse_folded(
    points: Array, rows: IndexArray, owners: IndexArray, kind: str, block: IndexArray, file: Path
) -> None:
    """Refuse cells with parts of zero volume or of different signs."""
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


_TIE = 1.0e-9  # relative; decides equal lengths the same way on every machine


def stitch(points: Array, left: Sequence[int], right: Sequence[int]) -> list[tuple[int, int, int]]:
    """Return triangles of the strip between two lines of points, the shorter diagonal first.

    Args:
        points: Coordinates, shape (n, 2).
        left: Indices of the points of the line on the left in the direction of travel.
        right: Indices of the points of the other line, same direction; end points may be shared.

    Returns:
        Counter-clockwise index triples.
    """
    triangles = []
    i = j = 0
    while i + 1 < len(left) or j + 1 < len(right):
        can_left, can_right = i + 1 < len(left), j + 1 < len(right)
        if can_left and can_right:
            ahead_left = np.linalg.norm(points[left[i + 1]] - points[right[j]])
            ahead_right = np.linalg.norm(points[right[j + 1]] - points[left[i]])
            can_left = bool(ahead_left < ahead_right * (1.0 - _TIE))
        if can_left:
            triangles.append((left[i], right[j], left[i + 1]))
            i += 1
        else:
            triangles.append((left[i], right[j], right[j + 1]))
            j += 1
    return [triangle for triangle in triangles if len(set(triangle)) == 3]


def flip_to_delaunay(points: Array, triangles: Sequence[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Return triangles after edge flips, with opposite angles of at most 180 degrees in sum (Lawson 1977)."""
    current = [tuple(triangle) for triangle in triangles]
    for _ in range(10 * len(current)):
        pair = _first_illegal_edge(points, current)
        if pair is None:
            break
        one, other, a, b, c, d = pair
        current[one], current[other] = (a, d, c), (d, b, c)
    return [(int(a), int(b), int(c)) for a, b, c in current]


def _first_illegal_edge(
    points: Array, triangles: Sequence[tuple[int, ...]]
) -> tuple[int, int, int, int, int, int] | None:
    """Return triangles (one, other) and their edge a-b to flip, with apexes c (left of a-b) and d."""
    owner: dict[tuple[int, int], tuple[int, int]] = {}
    for index, (a, b, c) in enumerate(triangles):
        for start, end, apex in ((a, b, c), (b, c, a), (c, a, b)):
            owner[start, end] = (index, apex)
    for (a, b), (one, c) in owner.items():
        if a < b and (b, a) in owner:
            other, d = owner[b, a]
            if _angle(points, a, c, b) + _angle(points, a, d, b) > np.pi + 1.0e-6:
                return one, other, a, b, c, d
    return None


def _angle(points: Array, a: int, apex: int, b: int) -> float:
    u, v = points[a] - points[apex], points[b] - points[apex]
    return float(np.arctan2(abs(u[0] * v[1] - u[1] * v[0]), u @ v))


def smooth(points: Array, triangles: IndexArray, movable: Array, sweeps: int = 20) -> Array:
    """Return points moved towards the mean of their neighbours (Laplace), each along its own projection.

    Args:
        points: Coordinates, shape (n, 2).
        triangles: Index triples, shape (k, 3).
        movable: Projection of a point's motion, shape (n, 2, 2): identity for free points, zero for fixed
            ones, t tᵀ for points that slide along the unit vector t.
        sweeps: Number of passes over all points (all points move at once in a pass).

    Returns:
        New coordinates, shape (n, 2).
    """
    edges = unique_pairs(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))
    start = np.concatenate([edges[:, 0], edges[:, 1]])
    end = np.concatenate([edges[:, 1], edges[:, 0]])
    degree = np.bincount(start, minlength=len(points))[:, None]
    for _ in range(sweeps):
        mean = np.zeros_like(points)
        np.add.at(mean, start, points[end])
        points = points + 0.5 * np.einsum("nij,nj->ni", movable, mean / degree - points)
    return points


_KUHN_PATHS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


def orient_tets(points: Array, tets: IndexArray) -> IndexArray:
    """Return the tetrahedra (m, 4), the last two nodes swapped if the signed volume is negative."""
    corners = points[tets]
    edges = corners[:, 1:] - corners[:, :1]
    negative = np.linalg.det(edges) < 0.0
    result = np.array(tets, dtype=np.int64, order="C")
    result[negative, 2], result[negative, 3] = tets[negative, 3], tets[negative, 2]
    return result


def extrude(
    points: Array, triangles: IndexArray, labels: IndexArray, heights: Array
) -> tuple[Array, IndexArray]:
    """Return tetrahedra of a plane triangulation swept along z: three per triangle and layer.

    The prism of a triangle and layer is cut along the diagonals that rise from the lower to the higher label
    (in every second layer, from the higher to the lower), so prisms that share a face agree on its diagonal,
    and mirrored triangles with equal labels are cut into mirror images.

    Args:
        points: Coordinates in [m], shape (n, 2).
        triangles: Index triples, shape (k, 3).
        labels: One integer per point, shape (n,); the three labels of a triangle differ.
        heights: Rising z of the layers in [m], shape (layers + 1,).

    Returns:
        Points, shape ((layers + 1) n, 3), layer by layer; positively oriented tets, shape (3 k layers, 4).
    """
    n, layers = len(points), len(heights) - 1
    solid = np.column_stack([np.tile(points, (layers + 1, 1)), np.repeat(heights, n)])
    order = np.take_along_axis(triangles, np.argsort(labels[triangles], axis=1), axis=1)
    tets = []
    for layer in range(layers):
        a, b, c = (order if layer % 2 == 0 else order[:, ::-1]).T + layer * n
        for tet in ((a, b, c, c + n), (a, b, b + n, c + n), (a, a + n, b + n, c + n)):
            tets.append(np.column_stack(tet))
    return solid, orient_tets(solid, np.concatenate(tets))


_HEXAHEDRON = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""Corners of a cell in VTK's order."""


def box_mesh(
    lengths: Sequence[float],
    cells: Sequence[int],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    name: str = "box",
    *,
    hexahedra: bool = False,
) -> TetMesh:
    """Return a structured box: six tetrahedra per cell around a space diagonal (Kuhn).

    Neighbouring cells mirror each other. With even numbers of cells the mesh is its own mirror image in the
    three middle planes.

    Args:
        lengths: Edge lengths along x, y, z in [m], > 0.
        cells: Numbers of cells along x, y, z, >= 1.
        origin: Corner with the smallest coordinates in [m].
        name: Name of the mesh.
        hexahedra: Hold the cells themselves, too, which bodies then consist of.

    Returns:
        Positively oriented mesh; node (i, j, k) has index (i (cells_y + 1) + j) (cells_z + 1) + k.

    Raises:
        MeshError: a length is not > 0 or a number of cells not >= 1.
    """
    if len(lengths) != 3 or not all(0.0 < length < np.inf for length in lengths):
        raise MeshError(name, f"lengths {list(lengths)} must be three numbers > 0 m")
    if len(cells) != 3 or not all(count >= 1 for count in cells):
        raise MeshError(name, f"cells {list(cells)} must be three whole numbers >= 1")
    axes = [
        start + np.linspace(0.0, length, count + 1)
        for start, length, count in zip(origin, lengths, cells, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.arange(len(points)).reshape([count + 1 for count in cells])
    cell = np.ascontiguousarray(np.indices(tuple(cells)).reshape(3, -1).T)
    low, step = cell + cell % 2, 1 - 2 * (cell % 2)  # odd cells start at their far corner: mirrored
    tets = []
    for path in _KUHN_PATHS:
        corner = low.copy()
        corners = [node[tuple(corner.T)]]
        for axis in path:
            corner[:, axis] += step[:, axis]
            corners.append(node[tuple(corner.T)])
        tets.append(np.column_stack(corners))
    mesh = TetMesh(points, orient_tets(points, np.stack(tets, axis=1).reshape(-1, 4)), name)
    if not hexahedra:
        return mesh
    corners = cell[:, None] + np.array(_HEXAHEDRON)
    block = CellBlock(node[tuple(np.moveaxis(corners, 2, 0))], np.repeat(np.arange(len(cell)), 6))
    return replace(mesh, blocks={"hexahedron": block})
