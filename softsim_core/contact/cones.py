"""Outward normals of features, and the directions in which a feature is what is closest of its surface."""

from __future__ import annotations

from math import acos

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.closest import FACE
from softsim_core.contact.compile import kernel
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import Vector, add, dot, length, minus, row, scaled, unit

CONE = 0.1
"""Sine by which a direction may leave the cone of directions in which a feature is the closest part of its
own surface. Some slack keeps all vertices of a face that lies almost flat."""
EXACT = 1.0e-6
"""The same for the feature on which the closest point was found: only round-off is forgiven."""
_RIDGE = 0.02
"""An edge whose two triangles fall away by less than this (sum of two sines) counts as flat."""


@kernel
def edge_normal(edge: int, sides: IndexArray, normals: Array) -> Vector:
    """Sum of the unit normals of the edge's triangles."""
    first = row(normals, sides[edge, 0])
    second = sides[edge, 1]
    return add(first, row(normals, second)) if second >= 0 else first


@kernel
def vertex_normal(
    v: int, points: Array, fan_start: IndexArray, fan: IndexArray, triangles: IndexArray, normals: Array
) -> Vector:
    """Sum of the normals around a vertex times the angles there.

    Source: Baerentzen and Aanaes 2005: its sign tells inside from outside wherever v is the closest point.
    """
    total = (0.0, 0.0, 0.0)
    p = row(points, v)
    for at in range(fan_start[v], fan_start[v + 1]):
        t = fan[at]
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        second, third = (j, k) if i == v else (k, i) if j == v else (i, j)
        cosine = dot(unit(minus(row(points, second), p)), unit(minus(row(points, third), p)))
        total = add(total, scaled(row(normals, t), acos(min(1.0, max(-1.0, cosine)))))
    return total


@kernel
def outward_at(t: int, feature: int, points: Array, topology: Topology, normals: Array) -> Vector:
    """Outward normal, of any length, of a feature of triangle t: its face, or an edge or corner it shares."""
    if feature == FACE:
        return row(normals, t)
    if feature >= 3:
        return edge_normal(topology.triangle_edges[t, feature - 3], topology.sides, normals)
    corner = topology.triangles[t, feature]
    return vertex_normal(corner, points, topology.fan_start, topology.fan, topology.triangles, normals)


@kernel
def opposed(v: int, outward: Vector, fan_start: IndexArray, fan: IndexArray, normals: Array) -> bool:
    """Whether a triangle around v faces the outward direction of the other surface."""
    limit = -1e-3 * length(outward)
    for at in range(fan_start[v], fan_start[v + 1]):  # noqa: SIM110 - Numba compiles no generators
        if dot(row(normals, fan[at]), outward) < limit:
            return True
    return False


@kernel
def vertex_is_closest(
    v: int, direction: Vector, sine: float, ring_start: IndexArray, ring: IndexArray, points: Array
) -> bool:
    """Whether no neighbour of v lies farther along `direction`, by up to `sine` of its distance."""
    p = row(points, v)
    limit = sine * length(direction)
    for at in range(ring_start[v], ring_start[v + 1]):
        off = minus(row(points, ring[at]), p)
        if dot(off, direction) > limit * length(off):
            return False
    return True


@kernel
def edge_is_closest(
    edge: int, at: Vector, direction: Vector, sine: float, opposite: IndexArray, points: Array
) -> bool:
    """Whether the edge's triangles do not rise along `direction` from the point `at` of the edge."""
    limit = sine * length(direction)
    for side in range(2):
        third = opposite[edge, side]
        if third >= 0:
            off = minus(row(points, third), at)
            if dot(off, direction) > limit * length(off):
                return False
    return True


@kernel
def is_ridge(
    edge: int, at: Vector, along: Vector, direction: Vector, opposite: IndexArray, points: Array
) -> bool:
    """Whether the edge's triangles fall away from `direction`, and it is not flat.

    The unit vector `direction` is normal to the edge, which runs along `along`.
    """
    if opposite[edge, 1] < 0:
        return edge_is_closest(edge, at, direction, CONE, opposite, points)
    fall = 0.0
    for side in range(2):
        off = minus(row(points, opposite[edge, side]), at)
        aside = minus(off, scaled(along, dot(off, along) / dot(along, along)))
        rise = dot(off, direction) / length(aside)
        if rise > CONE:
            return False
        fall -= rise
    return fall > _RIDGE
