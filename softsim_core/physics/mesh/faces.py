"""Boundary faces of linear and quadratic tetrahedra with all their nodes, and the enclosed hollows."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.mesh.surface import FACES, alone
from softsim_core.physics.mesh.types import MIDDLES, TetMesh

_EDGE = {tuple(sorted(pair)): 4 + k for k, pair in enumerate(MIDDLES.tolist())}
_NODES = np.array(
    [
        [*face, *(_EDGE[tuple(sorted((face[i], face[(i + 1) % 3])))] for i in range(3))]
        for face in FACES.tolist()
    ]
)
"""The same faces with the nodes on the edges 0-1, 1-2, 2-0 after the corners."""


def boundary_faces(mesh: TetMesh) -> IndexArray:
    """Return faces that belong to one cell only: corners, outward by the right-hand rule, then edge nodes.

    Returns:
        Node indices, shape (k, 3) of linear cells, (k, 6) of quadratic ones.

    Raises:
        MeshError: a face is shared by more than two cells.
    """
    tets = mesh.tets
    corners = mesh.points[tets[:, :4]]
    inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    local = _NODES if mesh.order == 2 else _NODES[:, :3]
    faces = tets[:, local]
    mirrored = [0, 2, 1, 5, 4, 3] if mesh.order == 2 else [0, 2, 1]
    faces[inverted] = faces[inverted][:, :, mirrored]
    faces = faces.reshape(-1, local.shape[1])
    return np.ascontiguousarray(faces[alone(faces[:, :3], mesh.name)], dtype=np.int64)


def triangles_of(mesh: TetMesh, triangles: IndexArray, corners: IndexArray) -> BoolArray:
    """Return which triangles of the boundary, in the form of `surface.boundary`, belong to some faces.

    Args:
        mesh: The mesh.
        triangles: Node indices, shape (k, 3); of a quadratic mesh four for each face.
        corners: Faces by their corners in any order, shape (f, 3).

    Returns:
        Shape (k,).
    """
    ends = np.repeat(np.arange(len(mesh.points))[:, None], 2, axis=1)  # of the edge of a node
    if mesh.order == 2:
        ends[mesh.tets[:, 4:]] = mesh.tets[:, MIDDLES]
    chosen = {frozenset(face) for face in corners.tolist()}
    own = ends[triangles].reshape(len(triangles), -1).tolist()
    return np.array([frozenset(each) in chosen for each in own], dtype=bool)


def cavities(mesh: TetMesh) -> list[IndexArray]:
    """Return the faces of each hollow that the mesh encloses, oriented out of the hollow."""
    faces = boundary_faces(mesh)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = sp.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(mesh.points),) * 2)
    _, label = connected_components(graph, directed=False)
    own = label[faces[:, 0]]
    found = []
    for part in np.unique(own).tolist():
        chosen = faces[own == part]
        a, b, c = np.moveaxis(mesh.points[chosen[:, :3]], 1, 0)
        if np.einsum("ki,ki->", a, np.cross(b, c)) < 0.0:
            found.append(flip_faces(chosen))
    return found


def flip_faces(faces: IndexArray) -> IndexArray:
    """Return the same faces with the opposite orientation."""
    return np.ascontiguousarray(faces[:, [0, 2, 1, 5, 4, 3][: faces.shape[1]]])


def encloses(points: Array, faces: IndexArray, place: Array) -> bool:
    """Return whether a closed surface (its corners over points (n, 3)) encloses a point (3,).

    Source: van Oosterom, Strackee 1983, The solid angle of a plane triangle.
    """
    a, b, c = np.moveaxis(points[faces[:, :3]] - place, 1, 0)
    lengths = [np.linalg.norm(each, axis=1) for each in (a, b, c)]
    above = np.einsum("ki,ki->k", a, np.cross(b, c))
    below = lengths[0] * lengths[1] * lengths[2] + np.einsum("ki,ki->k", a, b) * lengths[2]
    below += np.einsum("ki,ki->k", b, c) * lengths[0] + np.einsum("ki,ki->k", c, a) * lengths[1]
    return bool(abs(2.0 * np.arctan2(above, below).sum()) > 2.0 * np.pi)
