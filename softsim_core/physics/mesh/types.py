"""Meshes as immutable arrays in [m]: tetrahedra, linear or quadratic, and cells that are split into them.

Surfaces, contact, embedding, checks and pictures work on tetrahedra. The nodes of a quadratic one are in
VTK's order: four corners, then the middles of `MIDDLES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from softsim_core.base import Array, IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class CellBlock:
    """Cells of one kind, such as hexahedra, that a mesh also holds as tetrahedra.

    Attributes:
        cells: Node indices in VTK's order, shape (k, a).
        owner: The cell that each tetrahedron of the mesh is a part of, -1: none of these; shape (m,).
    """

    cells: IndexArray
    owner: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class TetMesh:
    """A mesh of linear or quadratic tetrahedra.

    Attributes:
        points: Node positions in [m], shape (n, 3).
        tets: Node indices, shape (m, 4), or (m, 10) with nodes on the edges, see mesh.quadratic; positively
            oriented or not (volumes are absolute).
        name: Origin of the mesh, for messages.
        surfaces: Faces by their names in the file, as indices of their corners, shapes (k, 3).
        groups: Nodes by the names in the file of their points, lines, faces or cells.
        cell_groups: Cells by the names of volumes in the file: rows of `tets`, ascending.
        blocks: Cells of other kinds by meshio's name ("hexahedron"), which some of the tetrahedra fill; an
            element can take them whole, see `whole_cells`.
        around: Largest distance outside, in heights of a cell, of a point that an actuator binds to it.
    """

    points: Array
    tets: IndexArray
    name: str = "mesh"
    surfaces: Mapping[str, IndexArray] = field(default_factory=dict)
    groups: Mapping[str, IndexArray] = field(default_factory=dict)
    cell_groups: Mapping[str, IndexArray] = field(default_factory=dict)
    blocks: Mapping[str, CellBlock] = field(default_factory=dict)
    around: float = 0.02

    @property
    def order(self) -> int:
        """1 for linear cells, 2 for quadratic ones."""
        return 2 if self.tets.shape[1:] == (10,) else 1


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """A mesh of triangles, outward if closed.

    Attributes:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).
        name: Origin of the mesh, for messages.
    """

    points: Array
    triangles: IndexArray
    name: str = "surface"


TETRAHEDRA = {1: "tetra", 2: "tetra10"}
"""meshio's name of the tetrahedra of a mesh by its order."""

TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Faces opposite nodes 0..3 of a positively oriented tetrahedron, seen from outside counter-clockwise."""

MIDDLES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""The two corners of the edge of each of the nodes 4 to 9."""

_REFERENCE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
_AT_CORNERS = np.array([[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3]])
_AROUND = {(4, 9): (5, 6, 7, 8), (5, 7): (4, 6, 9, 8), (6, 8): (4, 5, 9, 7)}
"""The octahedron between them, around each of its three diagonals: the other four nodes in order."""


def _inner() -> IndexArray:
    """Return the four parts of the octahedron for each diagonal, oriented as the cell, shape (3, 4, 4)."""
    nodes = np.concatenate([_REFERENCE, _REFERENCE[MIDDLES].mean(axis=1)])
    parts = np.array(
        [[[*pair, ring[k], ring[(k + 1) % 4]] for k in range(4)] for pair, ring in _AROUND.items()]
    )
    wrong = np.linalg.det(nodes[parts[..., 1:]] - nodes[parts[..., :1]]) < 0.0
    parts[wrong] = parts[wrong][:, [0, 1, 3, 2]]
    return parts


_DIAGONALS, _INNER = np.array(list(_AROUND)), _inner()


def quadratic(mesh: TetMesh) -> TetMesh:
    """Return the same tetrahedra with a node in the middle of each edge, after the existing nodes.

    Cells of other kinds are gone. A new node is in the groups of both ends of its edge. A mesh of order 2 is
    returned unchanged.
    """
    if mesh.order == 2:
        return mesh
    edges = np.sort(mesh.tets[:, MIDDLES].reshape(-1, 2), axis=1)
    unique, numbers = np.unique(edges, axis=0, return_inverse=True)
    points = np.concatenate([mesh.points, mesh.points[unique].mean(axis=1)])
    middles = len(mesh.points) + numbers.reshape(-1, 6)
    tets = np.concatenate([mesh.tets, middles], axis=1).astype(np.int64)
    groups = {
        name: np.concatenate([own, len(mesh.points) + np.flatnonzero(np.isin(unique, own).all(axis=1))])
        for name, own in mesh.groups.items()
    }
    return replace(mesh, points=points, tets=tets, groups=groups, blocks={})


def linear(mesh: TetMesh) -> TetMesh:
    """Return the cells on their corners alone, without the nodes on edges; a mesh of order 1 unchanged."""
    if mesh.order == 1:
        return mesh
    used, numbers = np.unique(mesh.tets[:, :4], return_inverse=True)
    return replace(
        mesh,
        points=mesh.points[used],
        tets=numbers.reshape(-1, 4).astype(np.int64),
        surfaces={name: np.searchsorted(used, faces) for name, faces in mesh.surfaces.items()},
        groups={name: np.flatnonzero(np.isin(used, own)) for name, own in mesh.groups.items()},
    )


def cell_middles(points: Array, cells: IndexArray) -> Array:
    """Return the mean of the corners of cells (k, a) in [m], shape (k, 3)."""
    corners = 4 if cells.shape[1] == 10 else cells.shape[1]
    return np.asarray(points[cells[:, :corners]].mean(axis=1))


def subdivide_mesh(mesh: TetMesh) -> TetMesh:
    """Return linear tetrahedra over the same nodes: eight per quadratic cell, in its place.

    Four lie at the corners, and four around the shortest diagonal of the octahedron between them, all
    oriented as the cell. Their boundary follows curved faces, with four triangles for each. A linear mesh is
    returned unchanged.
    """
    if mesh.order == 1:
        return mesh
    ends = mesh.points[mesh.tets[:, _DIAGONALS]]
    shortest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).argmin(axis=1)
    corners = np.broadcast_to(_AT_CORNERS, (len(ends), 4, 4))
    parts = np.concatenate([corners, _INNER[shortest]], axis=1).reshape(len(ends), -1)
    groups = {name: (8 * own[:, None] + np.arange(8)).reshape(-1) for name, own in mesh.cell_groups.items()}
    tets = np.take_along_axis(mesh.tets, parts, axis=1).reshape(-1, 4)
    return replace(mesh, tets=tets, cell_groups=groups)
