"""Which way a point inside a surface gets out: along the normal of the place that is nearest to it."""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.contact.boxes import Boxes
from softsim_core.contact.closest import closest_on_triangle
from softsim_core.contact.compile import kernel
from softsim_core.contact.cones import outward_at
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import Vector, add, dot, minus, row, scaled, unit

_AGAINST = -0.1
"""Cosine below which a normal leads the other way."""


@kernel
def leads_out(
    p: Vector, direction: Vector, s: int, reach: float, points: Array, topology: Topology, boxes: Boxes
) -> bool:
    """Whether the place of surface s nearest to p does not look against the unit vector `direction`.

    An edge on the far side of a thin sheet looks as if what stands before the sheet had come through it.
    """
    t, feature = _nearest(p, s, reach, points, topology, boxes)
    if t < 0:
        return True
    outward = outward_at(t, feature, points, topology, boxes.normal)
    return dot(unit(outward), direction) > _AGAINST


@kernel
def _nearest(
    p: Vector, s: int, reach: float, points: Array, topology: Topology, boxes: Boxes
) -> tuple[int, int]:
    """The triangle of surface s nearest to p, within `reach`, and its feature there; -1, -1 where none is."""
    stack, triangles = boxes.stack, topology.triangles
    least, nearest, where = reach * reach, -1, -1
    stack[0, 0] = topology.surface_node[s, 0]
    size = 1
    while size > 0:
        size -= 1
        node = stack[size, 0]
        if _squared_distance(p, boxes.node, node) > least:
            continue
        count, child = topology.node_count[node], topology.node_child[node]
        if count < 0:
            stack[size, 0], stack[size + 1, 0] = child, child + 1
            size += 2
            continue
        first = topology.node_first[node]
        for t in range(first, first + count):
            a, b, c = row(points, triangles[t, 0]), row(points, triangles[t, 1]), row(points, triangles[t, 2])
            u, v, w, feature = closest_on_triangle(p, a, b, c)
            gap = minus(p, add(add(scaled(a, u), scaled(b, v)), scaled(c, w)))
            squared = dot(gap, gap)
            if squared < least:
                least, nearest, where = squared, t, feature
    return nearest, where


@kernel
def _squared_distance(p: Vector, boxes: Array, i: int) -> float:
    """Squared distance of p to box i, 0 inside it."""
    total = 0.0
    for d in range(3):
        off = max(boxes[i, d] - p[d], p[d] - boxes[i, 3 + d], 0.0)
        total += off * off
    return total
