"""Where two triangles of different surfaces are closest: vertex against triangle, edge against edge."""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.contact.boxes import Boxes
from softsim_core.contact.closest import FACE, closest_on_lines, closest_on_triangle
from softsim_core.contact.compile import kernel
from softsim_core.contact.cones import (
    CONE,
    EXACT,
    edge_is_closest,
    edge_normal,
    is_ridge,
    opposed,
    outward_at,
    vertex_is_closest,
)
from softsim_core.contact.found import Found, Near, features, next_row, write, write_pair
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import add, cross, dot, length, minus, row, scaled, unit
from softsim_core.contact.way_out import leads_out

_PARALLEL = 4.0e-4
"""Edges at an angle with a squared sine below this have no contact between their insides."""


@kernel
def meet_vertices(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Vertices (and spheres) against triangles, as listed; sides a and b are surfaces sa and sb.

    A contact is a local minimum of the distance. Seen from inside, only the nearest contact of a vertex
    counts, and no deeper than half the reach; the sweep sorts that out once the pair is done. Spheres meet
    the vertices of deformable surfaces elsewhere.
    """
    triangles, normals, radii, owns = topology.triangles, boxes.normal, topology.radius, topology.owns
    for at in range(near.counts[0]):
        v, t, first = near.vertices[at, 0], near.vertices[at, 1], near.vertices[at, 2] == 0
        p = row(points, v)
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a, b, c = row(points, i), row(points, j), row(points, k)
        radius = radii[v]
        limit = reach + radius
        if abs(dot(minus(p, a), row(normals, t))) > limit:
            continue
        wi, wj, wk, feature = closest_on_triangle(p, a, b, c)
        q = add(add(scaled(a, wi), scaled(b, wj)), scaled(c, wk))
        gap = minus(p, q)
        distance = length(gap)
        if distance > limit:
            continue
        if feature != FACE and owns[t, feature] == 0:
            continue  # the triangle that owns the edge or corner looks at it
        vertex = triangles[t, feature] if feature < 3 else -1
        edge = topology.triangle_edges[t, feature - 3] if 3 <= feature < FACE else -1
        outward = outward_at(t, feature, points, topology, normals)
        inside = dot(gap, outward) < 0.0
        if inside and feature != FACE and topology.closed[sb if first else sa] == 0:
            continue  # behind the rim of an open surface
        boxes.nearest[v, int(inside)] = min(boxes.nearest[v, int(inside)], distance)
        if radius == 0.0 and not opposed(v, outward, topology.fan_start, topology.fan, normals):
            continue
        if inside and distance > 0.5 * reach:
            continue
        boxes.nearest[v, 2] = min(boxes.nearest[v, 2], distance)
        if vertex >= 0 and radius == 0.0 and not first:
            continue  # two vertices: met from the first surface
        if vertex >= 0 and radius > 0.0 and not inside and topology.soft[sb if first else sa] == 1:
            continue  # met as a corner, whether the closest point or not
        if edge >= 0 and not edge_is_closest(edge, q, gap, EXACT, topology.opposite, points):
            continue
        if vertex >= 0 and not vertex_is_closest(
            vertex, gap, EXACT, topology.ring_start, topology.ring, points
        ):
            continue
        normal = unit(outward)
        if feature != FACE and distance > 1e-9:
            normal = scaled(gap, (-1.0 if inside else 1.0) / distance)
        if radius == 0.0 and not vertex_is_closest(
            v, scaled(normal, -1.0), CONE, topology.ring_start, topology.ring, points
        ):
            continue
        spot = next_row(found.counter, found.distance)
        if spot < 0:
            continue
        found.distance[spot] = (-distance if inside else distance) - radius
        found.depth[spot] = distance if inside else 0.0
        found.seeker[spot] = v
        other = radii.shape[0] + topology.edges.shape[0] + t
        if edge >= 0:
            other = radii.shape[0] + edge
        elif vertex >= 0:
            other = vertex
        if first:
            write(found.a, found.a_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
            write(found.b, found.b_weights, spot, (i, j, k), (wi, wj, wk))
            write_pair(found.normal, found.pair, spot, normal, sa, sb)
            found.key[spot] = v * features(topology) + other
        else:
            write(found.a, found.a_weights, spot, (i, j, k), (wi, wj, wk))
            write(found.b, found.b_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
            write_pair(found.normal, found.pair, spot, scaled(normal, -1.0), sa, sb)
            found.key[spot] = other * features(topology) + v


@kernel
def meet_edges(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Edges of surface sa against edges of surface sb, as listed, where their insides are closest."""
    edges, normals = topology.edges, boxes.normal
    for at in range(near.counts[1]):
        e, f = near.edges[at, 0], near.edges[at, 1]
        e0, e1, f0, f1 = edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1]
        p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
        s, t, sine = closest_on_lines(p0, p1, q0, q1)
        if sine < _PARALLEL or min(s, t) <= EXACT or max(s, t) >= 1.0 - EXACT:
            continue
        along_e, along_f = minus(p1, p0), minus(q1, q0)
        p, q = add(p0, scaled(along_e, s)), add(q0, scaled(along_f, t))
        gap = minus(p, q)
        if dot(gap, gap) > reach * reach:
            continue
        out_e, out_f = edge_normal(e, topology.sides, normals), edge_normal(f, topology.sides, normals)
        normal = unit(cross(along_e, along_f))
        if dot(normal, minus(out_f, out_e)) < 0.0:
            normal = scaled(normal, -1.0)
        if dot(out_e, normal) >= 0.0 or dot(out_f, normal) <= 0.0:
            continue
        distance = dot(gap, normal)
        if distance < -0.5 * reach:
            continue
        if not is_ridge(f, q, along_f, normal, topology.opposite, points):
            continue
        back = scaled(normal, -1.0)
        if not is_ridge(e, p, along_e, back, topology.opposite, points):
            continue
        if distance < 0.0 and not (
            leads_out(p, normal, sb, reach, points, topology, boxes)
            and leads_out(q, back, sa, reach, points, topology, boxes)
        ):
            continue
        spot = next_row(found.counter, found.distance)
        if spot < 0:
            continue
        found.distance[spot], found.depth[spot], found.seeker[spot] = distance, 0.0, -1
        write(found.a, found.a_weights, spot, (e0, e1, e1), (1.0 - s, s, 0.0))
        write(found.b, found.b_weights, spot, (f0, f1, f1), (1.0 - t, t, 0.0))
        write_pair(found.normal, found.pair, spot, normal, sa, sb)
        n = topology.radius.shape[0]
        found.key[spot] = (n + e) * features(topology) + n + f
