"""All pairs of surfaces in one pass: broad phase, narrow phase, and what counts of what they find."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.detection.broad_phase import (
    Boxes,
    apart,
    compare_trees,
    refit,
    surface_boxes,
)
from softsim_core.contact.detection.candidates import Found, Near, mixed, move
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.geometry import dot, minus, row
from softsim_core.contact.detection.narrow_phase import (
    meet_corners,
    meet_edges,
    meet_leaves,
    meet_spheres,
)
from softsim_core.contact.detection.topology import Topology

_SAME = 1.0e-7
"""Contacts of a vertex whose points differ by less than this share of their triangle's edges are one."""
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
            first, end = topology.surface_vertex[s, 0], topology.surface_vertex[s, 1]
            boxes.nearest[first:end] = np.inf
            boxes.latest[first:end] = -1
        i, j = topology.surface_node[sa, 0], topology.surface_node[sb, 0]
        begin = found.counter[0]
        if topology.node_count[i] == 0 and topology.node_count[j] == 0:
            v, w = topology.node_first[i], topology.node_first[j]
            meet_spheres(v, w, sa, sb, reach, points, topology, found)
        else:
            compare_trees(i, j, reach, topology, boxes, near)
            meet_leaves(sa, sb, reach, points, topology, boxes, near, found)
            needed = max(needed, near.counts[0], near.counts[1], near.counts[2])
            if needed > near.vertices.shape[0]:
                return int(needed)
            close = min(reach, reach - alarm + _CLOSE * contact_distance)
            meet_corners(sa, sb, close, points, topology, boxes, near, found)
            meet_edges(sa, sb, reach, begin, points, topology, boxes, near, found)
        needed = max(needed, found.counter[0])
        if needed > found.distance.shape[0]:
            return int(needed)
        rest = contact_distance if topology.same_owner[p] else -1.0
        found.counter[0] = _sift(begin, found.counter[0], rest, points, rest_points, boxes, found)
    return int(needed)


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
        other = boxes.latest[v] if v >= 0 else -1
        while other >= 0 and not _same_points(k, other, points, found):
            other = found.earlier[other]
        if other >= 0:
            found.foremost[other] |= found.foremost[k]
        else:
            move(k, kept, found)
            if v >= 0:
                found.earlier[kept], boxes.latest[v] = boxes.latest[v], kept
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
    near = _SAME * _SAME * max(_squared_edge(found.a, k, points), _squared_edge(found.b, k, points))
    return dot(a, a) + dot(b, b) < near


@kernel
def _squared_edge(nodes: IndexArray, k: int, points: Array) -> float:
    """Squared length of the first edge of one side of contact k; 0 of a vertex."""
    edge = minus(row(points, nodes[k, 1]), row(points, nodes[k, 0]))
    return dot(edge, edge)
