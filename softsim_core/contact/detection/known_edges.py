"""Pairs of edges that are known to meet, looked at again where everything has moved on."""

from __future__ import annotations

from typing import NamedTuple

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.detection.candidates import Found, features, mixed, next_row, write, write_pair
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.geometry import (
    Vector,
    add,
    closest_on_segments,
    cross,
    dot,
    length,
    minus,
    row,
    scaled,
    unit,
)
from softsim_core.contact.detection.topology import Topology


class KnownEdges(NamedTuple):
    """k pairs of edges.

    Attributes:
        edges: Edge of the first surface, edge of the second, shape (k, 2).
        surfaces: Numbers of the two surfaces, first < second, shape (k, 2).
        together: Points of the two that are this near in [m] at rest, or nearer, never meet, shape (k,).
    """

    edges: IndexArray
    surfaces: IndexArray
    together: Array


@kernel
def meet_known_edges(known: KnownEdges, points: Array, rest: Array, topology: Topology, found: Found) -> None:
    """Where known pairs of edges are closest, end points included; what has crossed is left out.

    Args:
        known: The pairs.
        points: Vertex positions in [m], shape (V, 3).
        rest: The same at rest.
        topology: What stays the same.
        found: Overwritten; has room for all pairs.
    """
    edges, n = topology.edges, topology.radius.shape[0]
    found.counter[0] = 0
    for k in range(known.edges.shape[0]):
        e, f = known.edges[k, 0], known.edges[k, 1]
        e0, e1, f0, f1 = edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1]
        p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
        s, t = closest_on_segments(p0, p1, q0, q1)
        gap = minus(add(p0, scaled(minus(p1, p0), s)), add(q0, scaled(minus(q1, q0), t)))
        distance = length(gap)
        if dot(gap, minus(_outward(f, points, topology), _outward(e, points, topology))) <= 0.0:
            continue
        spot = next_row(found.counter, found.distance)
        found.distance[spot], found.depth[spot], found.seeker[spot] = distance, 0.0, -1
        found.foremost[spot] = False
        write(found.a, found.a_weights, spot, (e0, e1, e1), (1.0 - s, s, 0.0))
        write(found.b, found.b_weights, spot, (f0, f1, f1), (1.0 - t, t, 0.0))
        sa, sb = known.surfaces[k, 0], known.surfaces[k, 1]
        write_pair(found.normal, found.pair, spot, scaled(gap, 1.0 / distance), sa, sb)
        found.key[spot] = (n + e) * features(topology) + n + f
        apart = minus(
            mixed(found.a, found.a_weights, spot, rest), mixed(found.b, found.b_weights, spot, rest)
        )
        if length(apart) <= known.together[k]:
            found.counter[0] = spot


@kernel
def _outward(edge: int, points: Array, topology: Topology) -> Vector:
    """Sum of the unit normals of an edge's triangles."""
    total = (0.0, 0.0, 0.0)
    for side in range(2):
        t = topology.sides[edge, side]
        if t >= 0:
            a = row(points, topology.triangles[t, 0])
            b, c = row(points, topology.triangles[t, 1]), row(points, topology.triangles[t, 2])
            total = add(total, unit(cross(minus(b, a), minus(c, a))))
    return total
