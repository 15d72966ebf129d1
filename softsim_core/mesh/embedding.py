"""Barycentric children: points that follow the tetrahedron they lie in.

In a quadratic cell that is one of the eight linear tetrahedra between its nodes, see mesh.quadratic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError
from softsim_core.mesh.quadratic import subdivided
from softsim_core.mesh.types import TetMesh

_ON_FACE = 1.0e-5  # in element heights: a point on a face stays inside when rounded to float32


@dataclass(frozen=True, slots=True, eq=False)
class Embedding:
    """Points p = Σ w_k x_k of four nodes each, with weights frozen at the rest shape.

    Attributes:
        tets: The tetrahedron of each point, among the linear ones, shape (p,).
        weights: Barycentric weights, rows add up to 1, shape (p, 4); negative ones extrapolate.
        nodes: The nodes of that tetrahedron, shape (p, 4).
        outside: How far outside its tetrahedron a point lies, in element heights, 0 inside, shape (p,).
    """

    tets: IndexArray
    weights: Array
    nodes: IndexArray
    outside: Array


def embed(points: Array, mesh: TetMesh) -> Embedding:
    """Bind points to the tetrahedron that contains them; outside, to the one with the nearest centre.

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
    tets = subdivided(mesh).tets
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
    """Local coordinates b of points (p, 3) in their tetrahedra (p,), shape (p, 3)."""
    return np.asarray(np.einsum("pij,pj->pi", inverse[tets], points - corners[tets, 0]))


def _excess(local: Array) -> Array:
    """How far local coordinates (p, 3) lie outside the unit tetrahedron: d, shape (p,)."""
    return np.maximum((-local).max(axis=1), local.sum(axis=1) - 1.0)
