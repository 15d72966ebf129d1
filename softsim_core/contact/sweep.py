"""All pairs of surfaces in one pass: boxes of surfaces, then trees against trees, then triangles."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.boxes import Boxes, apart, beyond, outside, refit, segments_apart, surface_boxes
from softsim_core.contact.compile import kernel
from softsim_core.contact.found import Found, Near, mixed, move
from softsim_core.contact.narrow import meet_edges, meet_vertices
from softsim_core.contact.spheres import meet_corners, meet_spheres
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import dot, minus

_SAME = 1.0e-9
"""Contacts of a vertex whose points differ by less than this in [m] are one."""
_CLOSE = 1.5
"""Vertices of a dent meet a sphere from this many contact distances on, and what may move in the step."""


@kernel
def sweep(
    points: Array,
    rest_points: Array,
    alarm: float,
    travel: Array,
    contact_distance: float,
    topology: Topology,
    boxes: Boxes,
    near: Near,
    found: Found,
) -> int:
    """Contacts of all pairs of surfaces; returns how much room they and what is near need.

    Args:
        points: Vertex positions in [m], shape (V, 3).
        rest_points: The same at rest.
        alarm: Largest distance in [m] of surfaces that stand still.
        travel: What each surface adds to it in [m], shape (s,).
        contact_distance: Gap in [m] at rest. Two points of one body count only if they are farther apart than
            this in the rest shape.
        topology: What stays the same.
        boxes: Overwritten.
        near: Overwritten.
        found: Overwritten; its counter tells the number of contacts.
    """
    surface_boxes(points, topology, boxes)
    fresh = np.zeros(topology.closed.shape[0], dtype=np.bool_)
    found.counter[0] = 0
    needed = 0
    for p in range(topology.pairs.shape[0]):
        sa, sb = topology.pairs[p, 0], topology.pairs[p, 1]
        reach = alarm + travel[sa] + travel[sb]
        if apart(boxes.surface, sa, boxes.surface, sb, reach):
            continue
        for s in (sa, sb):
            if not fresh[s]:
                refit(s, points, topology, boxes)
                fresh[s] = True
            boxes.nearest[topology.surface_vertex[s, 0] : topology.surface_vertex[s, 1]] = np.inf
        i, j = topology.surface_node[sa, 0], topology.surface_node[sb, 0]
        begin = found.counter[0]
        if topology.node_count[i] == 0 and topology.node_count[j] == 0:
            v, w = topology.node_first[i], topology.node_first[j]
            meet_spheres(v, w, sa, sb, reach, points, topology, found)
        else:
            _compare_trees(i, j, reach, topology, boxes, near)
            _compare_leaves(reach, points, topology, boxes, near)
            needed = max(needed, near.counts[0], near.counts[1], near.counts[2])
            if needed > near.vertices.shape[0]:
                return int(needed)
            meet_vertices(sa, sb, reach, points, topology, boxes, near, found)
            close = min(reach, reach - alarm + _CLOSE * contact_distance)
            meet_corners(sa, sb, close, points, topology, boxes, near, found)
            meet_edges(sa, sb, reach, points, topology, boxes, near, found)
        needed = max(needed, found.counter[0])
        if needed > found.distance.shape[0]:
            return int(needed)
        rest = contact_distance if topology.same_owner[p] else -1.0
        found.counter[0] = _sift(begin, found.counter[0], rest, points, rest_points, boxes, found)
    return int(needed)


@kernel
def _compare_trees(
    root_a: int, root_b: int, reach: float, topology: Topology, boxes: Boxes, near: Near
) -> None:
    """Descend both trees together; list near leaves. Either tree may be a sphere."""
    stack, nodes, counts, child = boxes.stack, boxes.node, topology.node_count, topology.node_child
    near.counts[:] = 0
    stack[0, 0], stack[0, 1] = root_a, root_b
    size = 1
    while size > 0:
        size -= 1
        i, j = stack[size, 0], stack[size, 1]
        if apart(nodes, i, nodes, j, reach):
            continue
        if counts[i] < 0:
            stack[size, 0], stack[size, 1] = child[i] + 1, j
            stack[size + 1, 0], stack[size + 1, 1] = child[i], j
            size += 2
        elif counts[j] < 0:
            stack[size, 0], stack[size, 1] = i, child[j] + 1
            stack[size + 1, 0], stack[size + 1, 1] = i, child[j]
            size += 2
        elif counts[i] == 0 or counts[j] == 0:
            sphere, other = (i, j) if counts[i] == 0 else (j, i)
            for t in range(topology.node_first[other], topology.node_first[other] + counts[other]):
                _list_vertex(topology.node_first[sphere], t, int(counts[j] == 0), near.vertices, near.counts)
        else:
            _list_pair(i, j, 2, near.leaves, near.counts)


@kernel
def _compare_leaves(reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near) -> None:
    """List the features that triangles of near leaves look at, but for those plainly too far apart."""
    triangles, owns, around, normals = topology.triangles, topology.owns, boxes.triangle, boxes.normal
    edges, first, count = topology.triangle_edges, topology.node_first, topology.node_count
    for pair in range(min(near.counts[2], near.leaves.shape[0])):
        i, j = near.leaves[pair, 0], near.leaves[pair, 1]
        for t in range(first[i], first[i] + count[i]):
            if apart(around, t, boxes.node, j, reach):
                continue
            for u in range(first[j], first[j] + count[j]):
                if apart(around, t, around, u, reach):
                    continue
                if beyond(points, triangles, t, normals, u, reach):
                    continue
                if beyond(points, triangles, u, normals, t, reach):
                    continue
                for c in range(3):
                    if owns[t, c] and not outside(points, triangles[t, c], around, u, reach):
                        _list_vertex(triangles[t, c], u, 0, near.vertices, near.counts)
                    if owns[u, c] and not outside(points, triangles[u, c], around, t, reach):
                        _list_vertex(triangles[u, c], t, 1, near.vertices, near.counts)
                    if owns[t, 3 + c] == 0:
                        continue
                    k, m = triangles[t, c], triangles[t, (c + 1) % 3]
                    for d in range(3):
                        n, o = triangles[u, d], triangles[u, (d + 1) % 3]
                        if owns[u, 3 + d] and not segments_apart(points, k, m, n, o, reach):
                            _list_pair(edges[t, c], edges[u, d], 1, near.edges, near.counts)


@kernel
def _list_pair(a: int, b: int, kind: int, pairs: IndexArray, counts: IndexArray) -> None:
    """Add a and b to the list that counts[kind] belongs to."""
    at = counts[kind]
    counts[kind] += 1
    if at < pairs.shape[0]:
        pairs[at, 0], pairs[at, 1] = a, b


@kernel
def _list_vertex(v: int, t: int, second: int, vertices: IndexArray, counts: IndexArray) -> None:
    """Add vertex v and triangle t to the list."""
    at = counts[0]
    counts[0] += 1
    if at < vertices.shape[0]:
        vertices[at, 0], vertices[at, 1], vertices[at, 2] = v, t, second


@kernel
def _sift(
    begin: int, end: int, least_rest: float, points: Array, rest_points: Array, boxes: Boxes, found: Found
) -> int:
    """Keep, of the contacts of one pair, those that count; returns the new end.

    Left out: contacts from inside of a vertex that the nearest place has outside, or that are not its
    nearest; a vertex twice at one point (on an edge between coplanar triangles); points of one body that
    belong together at rest.
    """
    kept = begin
    for k in range(begin, end):
        v = found.seeker[k]
        if found.depth[k] > 0.0:
            nearest = boxes.nearest[v]
            if nearest[0] < nearest[1] or found.depth[k] > nearest[2] * (1.0 + 1e-9):
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
