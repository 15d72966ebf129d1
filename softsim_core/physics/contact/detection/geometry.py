"""Vectors, closest points, and the normal cones of features."""

from __future__ import annotations

from math import acos, sqrt
from typing import TypeAlias

from softsim_core.base import Array, IndexArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.detection.topology import Topology

Vector: TypeAlias = tuple[float, float, float]


@kernel
def row(points: Array, i: int) -> Vector:
    """Return row i of an array (n, 3)."""
    return points[i, 0], points[i, 1], points[i, 2]


@kernel
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(a: Vector, factor: float) -> Vector:
    """Return a times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def length(a: Vector) -> float:
    """Return the Euclidean length."""
    return sqrt(dot(a, a))


@kernel
def unit(a: Vector) -> Vector:
    """Return a divided by its length; zero stays zero."""
    size = length(a)
    return scale(a, 1.0 / size) if size > 0.0 else a


FACE = 6
"""Feature numbers of a triangle: 0..2 corners, 3..5 edges (3 + k: from corner k to k + 1), 6 the face."""


@kernel
def closest_on_triangle(p: Vector, a: Vector, b: Vector, c: Vector) -> tuple[float, float, float, int]:
    """Return the weights of corners a, b, c in the triangle's point closest to p, and the feature it is on.

    Source: Ericson, Real-Time Collision Detection, 2005, section 5.1.5 (Voronoi regions).
    """
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0, 0
    bp = minus(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0, 1
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0, 3
    cp = minus(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0, 2
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t, 5
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - t, t, 4
    total = va + vb + vc
    v, w = vb / total, vc / total
    return 1.0 - v - w, v, w, 6


@kernel
def closest_on_lines(p0: Vector, p1: Vector, q0: Vector, q1: Vector) -> tuple[float, float, float]:
    """Return where the lines p0 p1 and q0 q1 are closest: s, t and the squared sine of their angle.

    The points are p0 + s (p1 - p0) and q0 + t (q1 - q0); parallel lines give 0, 0, 0.
    """
    d1, d2, r = minus(p1, p0), minus(q1, q0), minus(p0, q0)
    a, e, b = dot(d1, d1), dot(d2, d2), dot(d1, d2)
    product = a * e
    denominator = product - b * b
    if denominator <= 1e-12 * product:
        return 0.0, 0.0, 0.0
    c, f = dot(d1, r), dot(d2, r)
    return (b * f - c * e) / denominator, (a * f - b * c) / denominator, denominator / product


@kernel
def closest_on_segments(p0: Vector, p1: Vector, q0: Vector, q1: Vector) -> tuple[float, float]:
    """Return s, t in 0..1 at which p0 + s (p1 - p0) and q0 + t (q1 - q0) are closest."""
    s, t, sine = closest_on_lines(p0, p1, q0, q1)
    if sine > 0.0 and min(s, t) >= 0.0 and max(s, t) <= 1.0:
        return s, t
    best_s, best_t = 0.0, nearest_share(p0, q0, q1)
    least = _compute_squared_distance(p0, p1, q0, q1, best_s, best_t)
    for s, t in (
        (1.0, nearest_share(p1, q0, q1)),
        (nearest_share(q0, p0, p1), 0.0),
        (nearest_share(q1, p0, p1), 1.0),
    ):
        squared = _compute_squared_distance(p0, p1, q0, q1, s, t)
        if squared < least:
            best_s, best_t, least = s, t, squared
    return best_s, best_t


@kernel
def nearest_share(p: Vector, q0: Vector, q1: Vector) -> float:
    """Return the share of the segment from q0 to q1 that is nearest to p."""
    along = minus(q1, q0)
    return min(1.0, max(0.0, dot(minus(p, q0), along) / dot(along, along)))


@kernel
def _compute_squared_distance(p0: Vector, p1: Vector, q0: Vector, q1: Vector, s: float, t: float) -> float:
    """Return the squared distance of the points at s and t."""
    gap = minus(add(p0, scale(minus(p1, p0), s)), add(q0, scale(minus(q1, q0), t)))
    return dot(gap, gap)


CONE = 0.1
"""Sine by which a direction may leave a feature's normal cone.

The normal cone contains the directions for which the feature is the closest part of its own surface. The
tolerance retains all vertices of a face that is almost flat.
"""
EXACT = 1.0e-6
"""The same for the feature on which the closest point was found: tolerance for rounding only."""
RIDGE = 0.02
"""An edge is flat if its two triangles fall away by less than this (sum of two sines)."""


@kernel
def edge_normal(edge: int, sides: IndexArray, normals: Array) -> Vector:
    """Return the sum of the unit normals of the edge's triangles."""
    first = row(normals, sides[edge, 0])
    second = sides[edge, 1]
    return add(first, row(normals, second)) if second >= 0 else first


@kernel
def vertex_normal(
    v: int, points: Array, fan_start: IndexArray, fan: IndexArray, triangles: IndexArray, normals: Array
) -> Vector:
    """Return the sum of the normals around a vertex, weighted by the angles there.

    Source: Baerentzen and Aanaes 2005. Its sign distinguishes inside from outside wherever v is the closest
    point.
    """
    total = (0.0, 0.0, 0.0)
    p = row(points, v)
    for at in range(fan_start[v], fan_start[v + 1]):
        t = fan[at]
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        second, third = (j, k) if i == v else (k, i) if j == v else (i, j)
        cosine = dot(unit(minus(row(points, second), p)), unit(minus(row(points, third), p)))
        total = add(total, scale(row(normals, t), acos(min(1.0, max(-1.0, cosine)))))
    return total


@kernel
def outward_at(t: int, feature: int, points: Array, topology: Topology, normals: Array) -> Vector:
    """Return the outward normal, of any length, of a feature of triangle t: its face, an edge or a corner."""
    if feature == FACE:
        return row(normals, t)
    if feature >= 3:
        return edge_normal(topology.triangle_edges[t, feature - 3], topology.sides, normals)
    corner = topology.triangles[t, feature]
    return vertex_normal(corner, points, topology.fan_start, topology.fan, topology.triangles, normals)


@kernel
def has_opposed_triangle(
    v: int, outward: Vector, fan_start: IndexArray, fan: IndexArray, normals: Array
) -> bool:
    """Return whether a triangle around v faces against the outward direction of the other surface."""
    limit = -1e-3 * length(outward)
    for at in range(fan_start[v], fan_start[v + 1]):  # noqa: SIM110 - Numba compiles no generators
        if dot(row(normals, fan[at]), outward) < limit:
            return True
    return False


@kernel
def vertex_is_closest(
    v: int, direction: Vector, sine: float, ring_start: IndexArray, ring: IndexArray, points: Array
) -> bool:
    """Return whether no neighbour of v is farther along `direction`, by more than `sine` of its distance."""
    p = row(points, v)
    for at in range(ring_start[v], ring_start[v + 1]):
        if _rises(row(points, ring[at]), p, direction, sine):
            return False
    return True


@kernel
def edge_is_closest(
    edge: int, at: Vector, direction: Vector, sine: float, opposite: IndexArray, points: Array
) -> bool:
    """Return whether the edge's triangles do not rise along `direction` from the point `at` of the edge."""
    for side in range(2):
        third = opposite[edge, side]
        if third >= 0 and _rises(row(points, third), at, direction, sine):
            return False
    return True


@kernel
def _rises(p: Vector, base: Vector, direction: Vector, sine: float) -> bool:
    """Return whether p is farther along `direction` than `base`, by more than `sine` of the distance."""
    off = minus(p, base)
    return bool(dot(off, direction) > sine * length(direction) * length(off))


@kernel
def fall_away(
    edge: int, at: Vector, along: Vector, direction: Vector, opposite: IndexArray, points: Array
) -> float:
    """Return by how much the edge's triangles fall away from `direction`; -1 where one rises.

    The value is the sum of two sines. The unit vector `direction` is normal to the edge, which runs along
    `along`. The rim of an open surface falls away by 1.
    """
    if opposite[edge, 1] < 0:
        return 1.0 if edge_is_closest(edge, at, direction, CONE, opposite, points) else -1.0
    fall = 0.0
    for side in range(2):
        off = minus(row(points, opposite[edge, side]), at)
        across = minus(off, scale(along, dot(off, along) / dot(along, along)))
        rise = dot(off, direction) / length(across)
        if rise > CONE:
            return -1.0
        fall -= rise
    return max(fall, 0.0)
