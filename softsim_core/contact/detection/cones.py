"""How far the linearised gaps of vertices close as things slide though the true ones do not."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.detector import Proximities
from softsim_core.contact.detection.geometry import Vector, add, dot, minus, row, scaled
from softsim_core.contact.detection.topology import Topology


@kernel
def false_closing(contacts: Proximities, points: Array, ahead: Array, topology: Topology) -> Array:
    """Return by how much in [m] the gap of each contact closes outside the cone of its vertex, shape (k,).

    The cone of a vertex holds the directions in which no neighbour lies farther; on a flat surface it is the
    normal alone. The direction to the edge of a body that slides towards the vertex is outside: a neighbour
    under that body rises along it. By the time the body gets from the neighbour to the vertex, its edge is no
    longer what is nearest, so the linearised gap closes while the true one stays.

    Args:
        contacts: The contacts, k of them.
        points: Vertex positions in [m], shape (v, 3).
        ahead: How far the vertices slide in [m], shape (v, 3).
        topology: What stays the same.
    """
    closing = np.zeros(contacts.key.shape[0])
    for c in range(closing.shape[0]):
        a, b, normal = contacts.a[c], contacts.b[c], row(contacts.normal, c)
        slip = minus(_mixed(a, contacts.a_weights[c], ahead), _mixed(b, contacts.b_weights[c], ahead))
        most = -dot(slip, normal)
        if most <= 0.0:
            continue
        for side in range(2):
            nodes, sign = (a, -1.0) if side == 0 else (b, 1.0)
            v = nodes[0]
            if v != nodes[1]:
                continue  # a face or an edge: its contact lies inside its cone
            for at in range(topology.ring_start[v], topology.ring_start[v + 1]):
                off = minus(row(points, topology.ring[at]), row(points, v))
                rise, towards = sign * dot(off, normal), -sign * dot(off, slip)
                if rise > 0.0 and towards > 0.0:
                    closing[c] = max(closing[c], min(rise * towards / dot(off, off), most))
    return closing


@kernel
def _mixed(nodes: IndexArray, weights: Array, values: Array) -> Vector:
    """Weighted sum of the rows of three nodes."""
    total = add(scaled(row(values, nodes[0]), weights[0]), scaled(row(values, nodes[1]), weights[1]))
    return add(total, scaled(row(values, nodes[2]), weights[2]))
