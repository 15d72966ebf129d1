"""All pairs of surfaces in one pass: boxes of surfaces, then trees against trees, then triangles."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.boxes import Boxes, apart, refit, surface_boxes
from softsim_core.contact.compile import kernel
from softsim_core.contact.found import Found, mixed, move
from softsim_core.contact.narrow import meet_edges, meet_spheres, meet_vertex
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import dot, minus

_SAME = 1.0e-9
"""Contacts of a vertex whose points differ by less than this in [m] are one."""


@kernel
def sweep(
    points: Array,
    rest_points: Array,
    reach: float,
    least_rest: float,
    topology: Topology,
    boxes: Boxes,
    found: Found,
) -> int:
    """Contacts of all pairs of surfaces; returns their number (rows beyond the room of `found` are lost).

    Args:
        points: Vertex positions in [m], shape (V, 3).
        rest_points: The same at rest.
        reach: Largest distance in [m].
        least_rest: Two points of one body count only if they are farther apart than this at rest, in [m].
        topology: What stays the same.
        boxes: Overwritten.
        found: Overwritten.
    """
    surface_boxes(points, topology, boxes)
    fresh = np.zeros(topology.closed.shape[0], dtype=np.bool_)
    found.counter[0] = 0
    for p in range(topology.pairs.shape[0]):
        sa, sb = topology.pairs[p, 0], topology.pairs[p, 1]
        if apart(boxes.surface, sa, boxes.surface, sb, reach):
            continue
        for s in (sa, sb):
            if not fresh[s]:
                refit(s, points, topology, boxes)
                fresh[s] = True
            boxes.nearest[topology.surface_vertex[s, 0] : topology.surface_vertex[s, 1]] = np.inf
        begin = found.counter[0]
        _compare_trees(sa, sb, reach, points, topology, boxes, found)
        if found.counter[0] > found.distance.shape[0]:
            return int(found.counter[0])
        rest = least_rest if topology.same_owner[p] else -1.0
        found.counter[0] = _sift(begin, found.counter[0], rest, points, rest_points, boxes, found)
    return int(found.counter[0])


@kernel
def _compare_trees(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, found: Found
) -> None:
    """Descend both trees together, the larger count of triangles first; compare triangles of near leaves."""
    stack = boxes.stack
    stack[0, 0], stack[0, 1] = topology.surface_node[sa, 0], topology.surface_node[sb, 0]
    size = 1
    while size > 0:
        size -= 1
        i, j = stack[size, 0], stack[size, 1]
        if apart(boxes.node, i, boxes.node, j, reach):
            continue
        if topology.node_count[i] < 0:
            child = topology.node_child[i]
            stack[size, 0], stack[size, 1] = child + 1, j
            stack[size + 1, 0], stack[size + 1, 1] = child, j
            size += 2
        elif topology.node_count[j] < 0:
            child = topology.node_child[j]
            stack[size, 0], stack[size, 1] = i, child + 1
            stack[size + 1, 0], stack[size + 1, 1] = i, child
            size += 2
        else:
            _compare_leaves(i, j, sa, sb, reach, points, topology, boxes, found)


@kernel
def _compare_leaves(
    i: int,
    j: int,
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    found: Found,
) -> None:
    """All triangles of leaf i of surface sa against all of leaf j of sb; either may be a sphere."""
    first_a, first_b = topology.node_first[i], topology.node_first[j]
    count_a, count_b = topology.node_count[i], topology.node_count[j]
    if count_a == 0 and count_b == 0:
        meet_spheres(first_a, first_b, sa, sb, reach, points, topology, found)
    elif count_a == 0:
        for t in range(first_b, first_b + count_b):
            meet_vertex(first_a, t, sa, sb, reach, points, topology, boxes, found)
    elif count_b == 0:
        for t in range(first_a, first_a + count_a):
            meet_vertex(first_b, t, sb, sa, reach, points, topology, boxes, found)
    else:
        for t in range(first_a, first_a + count_a):
            if apart(boxes.triangle, t, boxes.node, j, reach):
                continue
            for u in range(first_b, first_b + count_b):
                if not apart(boxes.triangle, t, boxes.triangle, u, reach):
                    _compare_triangles(t, u, sa, sb, reach, points, topology, boxes, found)


@kernel
def _compare_triangles(
    t: int,
    u: int,
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    found: Found,
) -> None:
    """The features that triangles t and u look at."""
    for c in range(3):
        if topology.owns[t, c]:
            meet_vertex(topology.triangles[t, c], u, sa, sb, reach, points, topology, boxes, found)
        if topology.owns[u, c]:
            meet_vertex(topology.triangles[u, c], t, sb, sa, reach, points, topology, boxes, found)
    for c in range(3):
        if topology.owns[t, 3 + c]:
            e = topology.triangle_edges[t, c]
            for d in range(3):
                if topology.owns[u, 3 + d]:
                    f = topology.triangle_edges[u, d]
                    meet_edges(e, f, sa, sb, reach, points, topology, boxes, found)


@kernel
def _sift(
    begin: int, end: int, least_rest: float, points: Array, rest_points: Array, boxes: Boxes, found: Found
) -> int:
    """Keep, of the contacts of one pair, those that count; returns the new end.

    Left out: contacts of a vertex inside the other surface that are not its nearest, a vertex twice at one
    point (on an edge between coplanar triangles), and points of one body that belong together at rest.
    """
    kept = begin
    for k in range(begin, end):
        v = found.seeker[k]
        if v >= 0 and found.depth[k] > boxes.nearest[v] * (1.0 + 1e-9):
            continue
        if least_rest >= 0.0 and _squared_gap(k, rest_points, found) <= least_rest * least_rest:
            continue
        twice = False
        for other in range(begin, kept):
            if v >= 0 and found.seeker[other] == v and _same_points(k, other, points, found):
                twice = True
                break
        if not twice:
            move(k, kept, found)
            kept += 1
    return kept


@kernel
def _squared_gap(k: int, points: Array, found: Found) -> float:
    """Squared distance between the two points of contact k."""
    between = minus(mixed(found.a, found.a_weights, k, points), mixed(found.b, found.b_weights, k, points))
    return dot(between, between)


@kernel
def _same_points(k: int, other: int, points: Array, found: Found) -> bool:
    """Whether two contacts touch the same points."""
    a = minus(mixed(found.a, found.a_weights, k, points), mixed(found.a, found.a_weights, other, points))
    b = minus(mixed(found.b, found.b_weights, k, points), mixed(found.b, found.b_weights, other, points))
    return dot(a, a) + dot(b, b) < _SAME * _SAME
