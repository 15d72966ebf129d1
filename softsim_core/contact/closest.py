"""Closest points between a point and a triangle, and between two segments."""

from __future__ import annotations

from softsim_core.contact.compile import kernel
from softsim_core.contact.vectors import Vector, dot, minus

FACE = 6
"""Feature numbers of a triangle: 0..2 corners, 3..5 edges (3 + k: from corner k to k + 1), 6 the inside."""


@kernel
def closest_on_triangle(p: Vector, a: Vector, b: Vector, c: Vector) -> tuple[float, float, float, int]:
    """Weights of the corners a, b, c in the point of the triangle closest to p, and the feature it lies on.

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
    """Where the lines p0 p1 and q0 q1 are closest: parameters s, t and the squared sine of their angle.

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
