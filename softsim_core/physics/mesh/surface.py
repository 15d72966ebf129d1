"""Surfaces: the boundary of tetrahedra, enclosed hollows, normals, closedness, Euler number, volume."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.base import Array, BoolArray, IndexArray, MeshError, unique_pairs
from softsim_core.physics.mesh.types import MIDDLES, TET_FACES, SurfaceMesh, TetMesh, subdivide_mesh


def boundary(mesh: TetMesh) -> IndexArray:
    """Return the faces that belong to one tetrahedron only, outward, shape (k, 3), in element order.

    Each face of a quadratic tetrahedron gives four triangles, which follow its curved shape.

    Raises:
        MeshError: a face is shared by more than two tetrahedra.
    """
    return _free_faces(subdivide_mesh(mesh), TET_FACES, [2, 1, 0])


def _free_faces(mesh: TetMesh, local: IndexArray, mirrored: list[int]) -> IndexArray:
    """Return faces of one tetrahedron only, outward.

    `local` (4, k) are the nodes of its faces, `mirrored` their order if it is inverted.
    """
    corners = mesh.points[mesh.tets[:, :4]]
    inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    faces = mesh.tets[:, local]
    faces[inverted] = faces[inverted][:, :, mirrored]
    faces = faces.reshape(-1, local.shape[1])
    own = np.sort(faces[:, :3], axis=1)
    _, inverse, counts = np.unique(own, axis=0, return_inverse=True, return_counts=True)
    if len(counts) and counts.max() > 2:
        face = int(np.flatnonzero(counts[inverse.reshape(-1)] > 2)[0])
        raise MeshError(
            mesh.name,
            f"face {faces[face, :3].tolist()} belongs to {counts.max()} tetrahedra, at most 2 can share one; "
            "remove overlapping or duplicate elements",
        )
    return np.ascontiguousarray(faces[counts[inverse.reshape(-1)] == 1], dtype=np.int64)


def closest_point(point: Array, corners: Array) -> Array:
    """Return the point of triangles (k, 3, 3) that is nearest to a point (3,), all in [m]."""
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
    """Return the volume in [m^3] inside a closed outward surface; meaningless for an open one."""
    corners = points[triangles] - points.mean(axis=0)
    return float(np.linalg.det(corners).sum() / 6.0)


_EDGE = {tuple(sorted(pair)): 4 + k for k, pair in enumerate(MIDDLES.tolist())}
_NODES = np.array(
    [
        [*face, *(_EDGE[tuple(sorted((face[i], face[(i + 1) % 3])))] for i in range(3))]
        for face in TET_FACES.tolist()
    ]
)
"""The same faces with the nodes on the edges 0-1, 1-2, 2-0 after the corners."""
_MIRRORED = [0, 2, 1, 5, 4, 3]
"""Order of the nodes of a face with the opposite orientation."""


def boundary_faces(mesh: TetMesh) -> IndexArray:
    """Return faces that belong to one cell only: corners, outward by the right-hand rule, then edge nodes.

    The shape is (k, 3) of linear cells, (k, 6) of quadratic ones.

    Raises:
        MeshError: a face is shared by more than two cells.
    """
    count = 6 if mesh.order == 2 else 3
    return _free_faces(mesh, _NODES[:, :count], _MIRRORED[:count])


def triangles_of(mesh: TetMesh, triangles: IndexArray, corners: IndexArray) -> BoolArray:
    """Return which triangles (k, 3) of `boundary` belong to faces with these corners (f, 3), in any order."""
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
    return np.ascontiguousarray(faces[:, _MIRRORED[: faces.shape[1]]])


def encloses(points: Array, faces: IndexArray, place: Array) -> bool:
    """Return whether a closed surface (its corners over points (n, 3)) encloses a point (3,)."""
    return bool(abs(winding_numbers(place[None], points[faces[:, :3]])[0]) > 0.5)


def winding_numbers(places: Array, corners: Array) -> Array:
    """Return the winding numbers of triangles (k, 3, 3) around places (p, 3), shape (p,).

    Source: van Oosterom, Strackee 1983, The solid angle of a plane triangle (their sum, over 4 pi).
    """
    a, b, c = (corners[None, :, k] - places[:, None] for k in range(3))
    na, nb, nc = (np.sqrt((each**2).sum(axis=-1)) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    rest = na * nb * nc + (a * b).sum(axis=-1) * nc + (b * c).sum(axis=-1) * na + (c * a).sum(axis=-1) * nb
    return np.asarray(np.arctan2(volume, rest).sum(axis=1) / (2.0 * np.pi))
