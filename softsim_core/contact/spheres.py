"""Spheres against spheres, and against the vertices of deformable surfaces."""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.contact.boxes import Boxes
from softsim_core.contact.compile import kernel
from softsim_core.contact.cones import vertex_normal
from softsim_core.contact.found import Found, Near, features, next_row, write, write_pair
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import dot, length, minus, row, scaled


@kernel
def meet_corners(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Spheres against all vertices of a deformable surface within `reach` that look at them, as listed.

    In a dent as round as the sphere, hardly a vertex is a local minimum of the distance, and which ones are
    changes from step to step; yet none may enter the sphere.
    """
    for at in range(near.counts[0]):
        v, t, first = near.vertices[at, 0], near.vertices[at, 1], near.vertices[at, 2] == 0
        if topology.radius[v] == 0.0 or topology.soft[sb if first else sa] == 0:
            continue
        limit = reach + topology.radius[v]
        for corner in range(3):
            u = topology.triangles[t, corner]
            if topology.owns[t, corner] == 0:
                continue
            gap = minus(row(points, v), row(points, u))
            if dot(gap, gap) > limit * limit:
                continue
            outward = vertex_normal(
                u, points, topology.fan_start, topology.fan, topology.triangles, boxes.normal
            )
            if dot(gap, outward) > 0.0:
                meet_spheres(v if first else u, u if first else v, sa, sb, reach, points, topology, found)


@kernel
def meet_spheres(
    v: int, w: int, sa: int, sb: int, reach: float, points: Array, topology: Topology, found: Found
) -> None:
    """Sphere v of surface sa against sphere w of surface sb; a vertex is a sphere without a radius."""
    gap = minus(row(points, v), row(points, w))
    centres = length(gap)
    distance = centres - topology.radius[v] - topology.radius[w]
    if distance > reach or centres <= 0.0:
        return
    spot = next_row(found.counter, found.distance)
    if spot < 0:
        return
    found.distance[spot], found.depth[spot], found.seeker[spot] = distance, 0.0, -1
    write(found.a, found.a_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
    write(found.b, found.b_weights, spot, (w, w, w), (1.0, 0.0, 0.0))
    write_pair(found.normal, found.pair, spot, scaled(gap, 1.0 / centres), sa, sb)
    found.key[spot] = v * features(topology) + w
