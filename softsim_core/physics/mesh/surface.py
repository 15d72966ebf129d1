"""Surfaces: the boundary of tetrahedra, enclosed hollows, normals, closedness, Euler number, volume."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.base import Array, BoolArray, IndexArray, MeshError, unique_pairs
from softsim_core.physics.mesh.types import MIDDLES, SurfaceMesh, TetMesh, subdivide_mesh

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Faces opposite nodes 0..3 of a positively oriented tetrahedron, seen from outside counter-clockwise."""


def boundary(mesh: TetMesh) -> IndexArray:
    """Return the faces that belong to one tetrahedron only.

    Args:
        mesh: Tetrahedra of either orientation. Each face of a quadratic one gives four triangles, which
            follow its curved shape.

    Returns:
        Node indices of the triangles, outward by the right-hand rule, shape (k, 3), in element order.

    Raises:
        MeshError: a face is shared by more than two tetrahedra.
    """
    tets = subdivide_mesh(mesh).tets
    corners = mesh.points[tets]
    inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    faces = tets[:, FACES]
    faces[inverted] = faces[inverted][:, :, ::-1]
    faces = faces.reshape(-1, 3)
    return np.ascontiguousarray(faces[alone(faces, mesh.name)], dtype=np.int64)


def alone(faces: IndexArray, mesh: str) -> BoolArray:
    """Return which faces, by their corners (k, 3), belong to one tetrahedron only; the name is for messages.

    Raises:
        MeshError: a face is shared by more than two tetrahedra.
    """
    _, inverse, counts = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    if len(counts) and counts.max() > 2:
        face = int(np.flatnonzero(counts[inverse.reshape(-1)] > 2)[0])
        raise MeshError(
            mesh,
            f"face {faces[face].tolist()} belongs to {counts.max()} tetrahedra, at most 2 can share one; "
            "remove overlapping or duplicate elements",
        )
    return np.asarray(counts[inverse.reshape(-1)] == 1)


def closest_point(point: Array, corners: Array) -> Array:
    """Return the point of triangles that is nearest to a point.

    Args:
        point: A point in [m], shape (3,).
        corners: Corners of the triangles in [m], shape (k, 3, 3).

    Returns:
        The nearest point on them, shape (3,).
    """
    edges = corners[:, [1, 2, 0]] - corners
    lengths = np.maximum((edges**2).sum(axis=2), np.finfo(float).tiny)
    along = np.clip(((point - corners) * edges).sum(axis=2) / lengths, 0.0, 1.0)
    on_edges = (corners + along[..., None] * edges).reshape(-1, 3)
    normals = np.cross(edges[:, 0], -edges[:, 2])
    squares = np.maximum((normals**2).sum(axis=1), np.finfo(float).tiny)
    heights = ((point - corners[:, 0]) * normals).sum(axis=1) / squares
    feet = point - heights[:, None] * normals
    inside = (np.cross(edges, feet[:, None] - corners) * normals[:, None]).sum(axis=2) >= 0.0
    candidates = np.concatenate([on_edges, feet[inside.all(axis=1)]])
    return np.asarray(candidates[np.argmin(((candidates - point) ** 2).sum(axis=1))])


def boundary_surface(mesh: TetMesh) -> SurfaceMesh:
    """Return the boundary as a separate surface, with only the points it uses, in node order."""
    triangles = boundary(mesh)
    used, renumbered = np.unique(triangles, return_inverse=True)
    return SurfaceMesh(mesh.points[used], renumbered.reshape(-1, 3).astype(np.int64), mesh.name)


def triangle_normals(points: Array, triangles: IndexArray) -> Array:
    """Return normal times area in [m^2], shape (k, 3), of triangles (k, 3) over points (n, 3)."""
    corners = points[triangles]
    return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def vertex_normals(points: Array, triangles: IndexArray) -> Array:
    """Return unit normals at vertices: the area-weighted mean of the adjacent triangles' normals.

    Args:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).

    Returns:
        Unit vectors, shape (n, 3); zero at vertices without a triangle.
    """
    area_vectors = np.repeat(triangle_normals(points, triangles), 3, axis=0)
    sums = np.column_stack(  # without any triangle, bincount returns integers
        [
            np.bincount(triangles.reshape(-1), area_vectors[:, axis], minlength=len(points))
            for axis in range(3)
        ]
    ).astype(np.float64)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0.0)


def is_closed(triangles: IndexArray) -> bool:
    """Return whether every directed edge occurs exactly once per direction: closed, wound consistently."""
    start, end = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    forward = np.column_stack([start, end])
    unique, counts = np.unique(forward, axis=0, return_counts=True)
    return bool((counts == 1).all() and np.array_equal(unique, np.unique(forward[:, ::-1], axis=0)))


def euler_number(triangles: IndexArray) -> int:
    """Return vertices minus edges plus faces; 2 for a ball, 0 for a piece with one hole."""
    edges = unique_pairs(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))
    return len(np.unique(triangles)) - len(edges) + len(triangles)


def enclosed_volume(points: Array, triangles: IndexArray) -> float:
    """Return the volume in [m^3] inside a closed outward surface (divergence theorem).

    It is meaningless for an open one.
    """
    corners = points[triangles] - points.mean(axis=0)
    return float(np.linalg.det(corners).sum() / 6.0)


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
