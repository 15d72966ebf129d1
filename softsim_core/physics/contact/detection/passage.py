"""Continuous detection: the share of a step's motion during which nothing passes through a surface.

Every vertex is assumed to move along a straight line between the start and the end of the step. A vertex
passes a triangle, or an edge another edge, where the volume of the tetrahedron of their four points changes
its sign while they meet. Passing from behind a surface, or from behind its edge, does not count, because
there is no contact from that side either.

Source: Provot 1997, Collision and self-collision handling in cloth model dedicated to design garments.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from softsim_core.base import Array, BoolArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.detection.broad_phase import Boxes, apart, compare_trees, refit_nodes
from softsim_core.physics.contact.detection.candidates import Near
from softsim_core.physics.contact.detection.geometry import (
    CONE,
    Vector,
    add,
    closest_on_lines,
    cross,
    dot,
    length,
    minus,
    row,
    scale,
    unit,
)
from softsim_core.physics.contact.detection.topology import Topology

_HALVINGS = 40
"""Number of bisections in the search for the moment of passing."""
_OFF = 0.01
"""Share of a triangle's or edge's size by which the passing point may be outside of it."""
_SUNK = 0.8
"""Distance of two spheres, as a share of the sum of their radii, below which one passes the other."""


class VertexMotion(NamedTuple):
    """Motion of all collision vertices in a step.

    Attributes:
        rest: Vertex positions at rest in [m], shape (V, 3).
        before: Vertex positions at the start of the step in [m], shape (V, 3).
        after: Vertex positions at its end in [m], shape (V, 3).
        watched: Which pairs of surfaces are checked, shape (p,).
        together: Distance in [m] at rest up to which points of one body never pass each other.
    """

    rest: Array
    before: Array
    after: Array
    watched: BoolArray
    together: float


@kernel
def free_share(way: VertexMotion, topology: Topology, boxes: Boxes, near: Near) -> tuple[float, int]:
    """Return the share of the motion in 0..1 without passing, 1 for all, and the size that `near` needs.

    The arrays of `boxes` and `near` are overwritten.
    """
    share, needed = 1.0, 0
    for p in range(topology.pairs.shape[0]):
        if not way.watched[p]:
            continue
        sa, sb = topology.pairs[p, 0], topology.pairs[p, 1]
        _swept_box(sa, way, topology, boxes.surface)
        _swept_box(sb, way, topology, boxes.surface)
        if apart(boxes.surface, sa, boxes.surface, sb, 0.0):
            continue
        _swept_tree(sa, way, topology, boxes)
        _swept_tree(sb, way, topology, boxes)
        i, j = topology.surface_node[sa, 0], topology.surface_node[sb, 0]
        if topology.node_count[i] == 0 and topology.node_count[j] == 0:
            share = min(share, _spheres(topology.node_first[i], topology.node_first[j], way, topology))
            continue
        compare_trees(i, j, 0.0, topology, boxes, near)
        needed = max(needed, near.counts[0], near.counts[2])
        if needed > near.leaves.shape[0]:
            return share, int(needed)
        together = way.together if topology.same_owner[p] else -1.0
        for at in range(near.counts[0]):
            v, t = near.vertices[at, 0], near.vertices[at, 1]
            share = min(share, _vertex_passes(v, t, together, way, topology, boxes))
        for at in range(near.counts[2]):
            share = min(
                share, _leaves(near.leaves[at, 0], near.leaves[at, 1], together, way, topology, boxes)
            )
    return share, int(needed)


@kernel
def _swept_box(s: int, way: VertexMotion, topology: Topology, out: Array) -> None:
    """Compute the box that the vertices of surface s sweep."""
    first, end = topology.surface_vertex[s, 0], topology.surface_vertex[s, 1]
    radius = topology.radius[first]
    for d in range(3):
        low = high = way.before[first, d]
        for v in range(first, end):
            low = min(low, way.before[v, d], way.after[v, d])
            high = max(high, way.before[v, d], way.after[v, d])
        out[s, d], out[s, 3 + d] = low - radius, high + radius


@kernel
def _swept_tree(s: int, way: VertexMotion, topology: Topology, boxes: Boxes) -> None:
    """Compute the boxes that the triangles and tree nodes of surface s sweep."""
    first, end = topology.surface_node[s]
    if topology.node_count[first] == 0:
        boxes.node[first] = boxes.surface[s]
        return
    for t in range(topology.surface_triangle[s, 0], topology.surface_triangle[s, 1]):
        for d in range(3):
            low = high = way.before[topology.triangles[t, 0], d]
            for c in range(3):
                v = topology.triangles[t, c]
                low = min(low, way.before[v, d], way.after[v, d])
                high = max(high, way.before[v, d], way.after[v, d])
            boxes.triangle[t, d], boxes.triangle[t, 3 + d] = low, high
    refit_nodes(first, end, topology, boxes)


@kernel
def _leaves(i: int, j: int, together: float, way: VertexMotion, topology: Topology, boxes: Boxes) -> float:
    """Return the free share of the motion for the features of two leaves."""
    share, triangles, owns, edges = 1.0, topology.triangles, topology.owns, topology.triangle_edges
    first, count = topology.node_first, topology.node_count
    for t in range(first[i], first[i] + count[i]):
        if apart(boxes.triangle, t, boxes.node, j, 0.0):
            continue
        for u in range(first[j], first[j] + count[j]):
            if apart(boxes.triangle, t, boxes.triangle, u, 0.0):
                continue
            for c in range(3):
                if owns[t, c]:
                    share = min(share, _vertex_passes(triangles[t, c], u, together, way, topology, boxes))
                if owns[u, c]:
                    share = min(share, _vertex_passes(triangles[u, c], t, together, way, topology, boxes))
                if owns[t, 3 + c] == 0:
                    continue
                for d in range(3):
                    if owns[u, 3 + d]:
                        share = min(share, _edge_passes(edges[t, c], edges[u, d], together, way, topology))
    return share


@kernel
def _vertex_passes(
    v: int, t: int, together: float, way: VertexMotion, topology: Topology, boxes: Boxes
) -> float:
    """Return the share of the motion at which vertex v passes triangle t from outside, 1 if it does not."""
    for d in range(3):
        low, high = way.before[v, d], way.after[v, d]
        if max(low, high) < boxes.triangle[t, d] or min(low, high) > boxes.triangle[t, 3 + d]:
            return 1.0
    i, j, k = topology.triangles[t, 0], topology.triangles[t, 1], topology.triangles[t, 2]
    if _volume(0.0, v, i, j, k, way) <= 0.0 or _volume(1.0, v, i, j, k, way) >= 0.0:
        return 1.0
    share = _sign_change(v, i, j, k, way)
    p, a = _at(share, v, way), _at(share, i, way)
    ab, ac, ap = minus(_at(share, j, way), a), minus(_at(share, k, way), a), minus(p, a)
    normal = cross(ab, ac)
    square = dot(normal, normal)
    if square <= 0.0:
        return 1.0
    wj, wk = dot(cross(ap, ac), normal) / square, dot(cross(ab, ap), normal) / square
    if min(wj, wk, 1.0 - wj - wk) < -_OFF or not _opposes(v, normal, share, way, topology):
        return 1.0
    if together >= 0.0:
        base = row(way.rest, i)
        along = add(scale(minus(row(way.rest, j), base), wj), scale(minus(row(way.rest, k), base), wk))
        off = minus(row(way.rest, v), add(base, along))
        if dot(off, off) <= together * together:
            return 1.0
    return share


@kernel
def _edge_passes(e: int, f: int, together: float, way: VertexMotion, topology: Topology) -> float:
    """Return the share of the motion at which facing edges e and f pass each other, 1 if they do not."""
    i, j, k, m = topology.edges[e, 0], topology.edges[e, 1], topology.edges[f, 0], topology.edges[f, 1]
    for d in range(3):
        a, b, c, g = way.before[i, d], way.before[j, d], way.after[i, d], way.after[j, d]
        low, high = min(a, b, c, g), max(a, b, c, g)
        a, b, c, g = way.before[k, d], way.before[m, d], way.after[k, d], way.after[m, d]
        if min(a, b, c, g) > high or max(a, b, c, g) < low:
            return 1.0
    before = _volume(0.0, i, j, k, m, way)
    if before * _volume(1.0, i, j, k, m, way) >= 0.0:
        return 1.0
    share = _sign_change(i, j, k, m, way)
    p0, p1, q0, q1 = _at(share, i, way), _at(share, j, way), _at(share, k, way), _at(share, m, way)
    s, t, sine = closest_on_lines(p0, p1, q0, q1)
    if sine <= 0.0 or min(s, t) < -_OFF or max(s, t) > 1.0 + _OFF:
        return 1.0
    normal = cross(minus(p1, p0), minus(q1, q0))
    towards_e = scale(normal, -1.0) if before > 0.0 else normal
    p, towards_f = add(p0, scale(minus(p1, p0), s)), scale(towards_e, -1.0)
    if not _faces(e, p, towards_f, share, way, topology) or not _faces(f, p, towards_e, share, way, topology):
        return 1.0
    if together >= 0.0:
        p, q = row(way.rest, i), row(way.rest, k)
        p = add(p, scale(minus(row(way.rest, j), p), s))
        off = minus(p, add(q, scale(minus(row(way.rest, m), q), t)))
        if dot(off, off) <= together * together:
            return 1.0
    return share


@kernel
def _faces(
    edge: int, at: Vector, direction: Vector, share: float, way: VertexMotion, topology: Topology
) -> bool:
    """Return whether an edge faces `direction` and no triangle of it rises that way from the point `at`."""
    outward, limit = (0.0, 0.0, 0.0), CONE * length(direction)
    for side in range(2):
        t = topology.sides[edge, side]
        if t < 0:
            continue
        off = minus(_at(share, topology.opposite[edge, side], way), at)
        if dot(off, direction) > limit * length(off):
            return False
        outward = add(outward, _normal(t, share, way, topology))
    return dot(outward, direction) > 0.0


@kernel
def _opposes(v: int, outward: Vector, share: float, way: VertexMotion, topology: Topology) -> bool:
    """Return whether v is a sphere, or a triangle around it faces against the other surface's `outward`."""
    if topology.radius[v] > 0.0:
        return True
    for at in range(topology.fan_start[v], topology.fan_start[v + 1]):
        if dot(_normal(topology.fan[at], share, way, topology), outward) < 0.0:
            return True
    return False


@kernel
def _normal(t: int, share: float, way: VertexMotion, topology: Topology) -> Vector:
    """Return the unit normal of a triangle after a share of the motion."""
    i, j, k = topology.triangles[t, 0], topology.triangles[t, 1], topology.triangles[t, 2]
    a = _at(share, i, way)
    return unit(cross(minus(_at(share, j, way), a), minus(_at(share, k, way), a)))


@kernel
def _at(share: float, v: int, way: VertexMotion) -> Vector:
    """Return the position of vertex v after a share of its motion."""
    p = row(way.before, v)
    return add(p, scale(minus(row(way.after, v), p), share))


@kernel
def _volume(share: float, p: int, a: int, b: int, c: int, way: VertexMotion) -> float:
    """Return six times the volume of a tetrahedron, positive if a, b, c turn left as seen from p."""
    base = _at(share, a, way)
    normal = cross(minus(_at(share, b, way), base), minus(_at(share, c, way), base))
    return dot(minus(_at(share, p, way), base), normal)


@kernel
def _sign_change(p: int, a: int, b: int, c: int, way: VertexMotion) -> float:
    """Return the last share of the motion found at which the volume still has its initial sign."""
    low, high = 0.0, 1.0
    positive = _volume(0.0, p, a, b, c, way) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (_volume(middle, p, a, b, c, way) > 0.0) == positive:
            low = middle
        else:
            high = middle
    return low


@kernel
def _spheres(v: int, w: int, way: VertexMotion, topology: Topology) -> float:
    """Return the share of the motion at which spheres v and w overlap too far, 1 if they never do."""
    limit = _SUNK * (topology.radius[v] + topology.radius[w])
    start = minus(row(way.before, v), row(way.before, w))
    along = minus(minus(row(way.after, v), row(way.after, w)), start)
    a, b, c = dot(along, along), dot(start, along), dot(start, start) - limit * limit
    if c <= 0.0 or b >= 0.0 or b * b < a * c:
        return 1.0
    return float(min(1.0, c / (sqrt(b * b - a * c) - b)))
