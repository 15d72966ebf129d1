"""Points and surfaces that follow a tetrahedral mesh, and the placement of points.

In a quadratic cell they follow one of the eight linear tetrahedra between its nodes, see `subdivide_mesh`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from softsim_core.base import Array, IndexArray, MeshError, Placement, radians
from softsim_core.physics.mesh.types import SurfaceMesh, TetMesh, subdivide_mesh

_ON_FACE = 1.0e-5  # in element heights: a point on a face stays inside when rounded to float32


@dataclass(frozen=True, slots=True, eq=False)
class Embedding:
    """Points p = Σ w_k x_k of four nodes each, with constant weights from the rest shape.

    Attributes:
        tets: The tetrahedron of each point, among the linear ones, shape (p,).
        weights: Barycentric weights, rows add up to 1, shape (p, 4); negative ones extrapolate.
        nodes: The nodes of that tetrahedron, shape (p, 4).
        outside: Distance of a point outside its tetrahedron, in element heights, 0 inside, shape (p,).
    """

    tets: IndexArray
    weights: Array
    nodes: IndexArray
    outside: Array


def embed(points: Array, mesh: TetMesh) -> Embedding:
    """Bind points to the tetrahedron that contains them, or to the one with the nearest centre.

    With b = A⁻¹ (p - p0) (A: edge matrix) and d = max(-b1, -b2, -b3, b1 + b2 + b3 - 1), a tetrahedron
    contains the point if d <= 0 (up to 1e-5, so that a point on the boundary is never bound to an element
    elsewhere), and the smallest d wins. A point outside is extrapolated with the weights of the nearest one.

    Args:
        points: Positions at rest in [m], shape (p, 3).
        mesh: Tetrahedra at rest.

    Returns:
        The embedding.

    Raises:
        MeshError: points are not finite or not of shape (p, 3), or the mesh has an element of zero volume.
    """
    from scipy.spatial import cKDTree  # late: only scenes with children need it

    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise MeshError(
            mesh.name, f"points to embed, shape {points.shape}, must be finite and of shape (p, 3)"
        )
    tets = subdivide_mesh(mesh).tets
    corners = mesh.points[tets]
    try:
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    except np.linalg.LinAlgError as error:
        raise MeshError(mesh.name, "has an element of zero volume, nothing can be embedded in it") from error
    centres = corners.mean(axis=1)

    # A tetrahedron lies within the sphere around its centre through its farthest corner: no candidate is
    # missed.
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1) * (1.0 + 1.0e-3)
    near = cKDTree(points).query_ball_point(centres, radii) if len(points) else []
    tet = np.repeat(np.arange(len(near)), [len(found) for found in near])
    child = np.fromiter((index for found in near for index in found), dtype=np.int64, count=len(tet))
    excess = _excess(_local(points[child], tet, corners, inverse))
    order = np.lexsort((tet, excess, child))
    child, tet, excess = child[order], tet[order], excess[order]
    first = np.flatnonzero(np.diff(child, prepend=-1))
    inside = first[excess[first] <= _ON_FACE]

    chosen = np.full(len(points), -1, dtype=np.int64)
    chosen[child[inside]] = tet[inside]
    lost = np.flatnonzero(chosen < 0)
    if len(lost):
        chosen[lost] = cKDTree(centres).query(points[lost])[1]
    local = _local(points, chosen, corners, inverse)
    weights = np.column_stack([1.0 - local.sum(axis=1), local])
    return Embedding(chosen, weights, tets[chosen], np.maximum(_excess(local), 0.0))


def _local(points: Array, tets: IndexArray, corners: Array, inverse: Array) -> Array:
    """Return the local coordinates b of points (p, 3) in their tetrahedra (p,), shape (p, 3)."""
    return np.asarray(np.einsum("pij,pj->pi", inverse[tets], points - corners[tets, 0]))


def _excess(local: Array) -> Array:
    """Return the distance d of local coordinates (p, 3) outside the unit tetrahedron, shape (p,)."""
    return np.maximum((-local).max(axis=1), local.sum(axis=1) - 1.0)


def rotation_matrix(rotation_deg: Sequence[float]) -> Array:
    """Return R = Rz(γ) Ry(β) Rx(α), shape (3, 3), of angles (α, β, γ) in [deg]; exact at multiples of 90."""
    (ca, sa), (cb, sb), (cg, sg) = (_cosine_sine(angle) for angle in rotation_deg)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    about_z = np.array([[cg, -sg, 0.0], [sg, cg, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def place(points: Array, placement: Placement | None) -> Array:
    """Return new points in [m] from points (n, 3) in file units: R (scale x) + translation; None: a copy."""
    if placement is None:
        return points.copy()
    turned = (placement.scale * points) @ rotation_matrix(placement.rotation_deg).T
    return np.ascontiguousarray(turned + np.asarray(placement.translation, dtype=np.float64))


def _cosine_sine(angle_deg: float) -> tuple[float, float]:
    quarter = angle_deg / 90.0
    if quarter == round(quarter):
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    angle = radians(angle_deg)
    return float(np.cos(angle)), float(np.sin(angle))


class SurfaceFollower:
    """Surfaces bound to nodes.

    Args:
        parts: For each body its surface at rest, its embedding, and the number of the body's first node.
        count: Number of nodes of all bodies, n.

    Attributes:
        triangles: Vertex indices of all surfaces, shape (k, 3).
        rest_points: Vertices at rest in [m], shape (p, 3).
    """

    def __init__(self, parts: Sequence[tuple[SurfaceMesh, Embedding, int]], count: int) -> None:
        triangles, rest = [np.zeros((0, 3), np.int64)], [np.zeros((0, 3))]
        nodes, weights, points = [np.zeros((0, 4), np.int64)], [np.zeros((0, 4))], 0
        for surface, embedding, first in parts:
            triangles.append(surface.triangles + points)
            rest.append(surface.points)
            nodes.append(embedding.nodes + first)
            weights.append(embedding.weights)
            points += len(surface.points)
        self.triangles: IndexArray = np.concatenate(triangles)
        self.rest_points: Array = np.concatenate(rest)
        self._weights = csr_array(
            (np.concatenate(weights).ravel(), np.concatenate(nodes).ravel(), 4 * np.arange(points + 1)),
            shape=(points, count),
        )

    def follow(self, nodal: Array) -> Array:
        """Return nodal values (n,) or vectors (n, 3) interpolated at the vertices, shape (p,) or (p, 3)."""
        return np.asarray(self._weights @ nodal)
