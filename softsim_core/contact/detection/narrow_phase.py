"""Narrow phase: vertices against triangles, edges against edges, spheres, where they are closest."""

from __future__ import annotations

from math import inf

from softsim_core.arrays import Array
from softsim_core.contact.detection.broad_phase import (
    Boxes,
    apart,
    beyond,
    list_pair,
    list_vertex,
    outside,
    segments_apart,
)
from softsim_core.contact.detection.candidates import Found, Near, features, next_row, write, write_pair
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.geometry import (
    CONE,
    EXACT,
    FACE,
    RIDGE,
    Vector,
    add,
    closest_on_lines,
    closest_on_triangle,
    cross,
    dot,
    edge_is_closest,
    edge_normal,
    fall_away,
    length,
    minus,
    opposed,
    outward_at,
    row,
    scaled,
    unit,
    vertex_is_closest,
    vertex_normal,
)
from softsim_core.contact.detection.topology import Topology

_PARALLEL = 4.0e-4
"""Edges at an angle with a squared sine below this have no contact between their insides."""
_TOUCHING = 1.0e-7
"""Share of an edge's length below which a gap is too short for a direction."""


@kernel
def meet_leaves(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Vertices of near leaves against triangles, and a list of the edges whose insides are near.

    A triangle looks at the features that it owns, so that no two features are met twice. Fine surfaces that
    go far in a step have some hundred pairs within reach for each that can touch: vertices are met some at a
    time, and of the edges only those are listed that are closest between their ends.
    """
    most = near.vertices.shape[0] - 2
    triangles, owns, around, normals = topology.triangles, topology.owns, boxes.triangle, boxes.normal
    edges, ends = topology.triangle_edges, topology.edges
    first, count = topology.node_first, topology.node_count
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
                        list_vertex(triangles[t, c], u, 0, near.vertices, near.counts)
                    if owns[u, c] and not outside(points, triangles[u, c], around, t, reach):
                        list_vertex(triangles[u, c], t, 1, near.vertices, near.counts)
                    if near.counts[0] > most:
                        meet_vertices(sa, sb, reach, points, topology, boxes, near, found)
                        near.counts[0] = 0
                    if owns[t, 3 + c] == 0:
                        continue
                    e = edges[t, c]
                    for d in range(3):
                        f = edges[u, d]
                        if owns[u, 3 + d] and insides_meet(
                            points, ends[e, 0], ends[e, 1], ends[f, 0], ends[f, 1], reach
                        ):
                            list_pair(e, f, 1, near.edges, near.counts)
    meet_vertices(sa, sb, reach, points, topology, boxes, near, found)


@kernel
def insides_meet(points: Array, e0: int, e1: int, f0: int, f1: int, reach: float) -> bool:
    """Whether the edges e0 e1 and f0 f1, not parallel, are closest between their ends, within `reach`."""
    if segments_apart(points, e0, e1, f0, f1, reach):
        return False
    p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
    s, t, _ = closest_on_lines(p0, p1, q0, q1)
    if min(s, t) <= EXACT or max(s, t) >= 1.0 - EXACT:  # parallel ones, too
        return False
    gap = minus(add(p0, scaled(minus(p1, p0), s)), add(q0, scaled(minus(q1, q0), t)))
    return bool(dot(gap, gap) <= reach * reach)


@kernel
def meet_vertices(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Vertices (and spheres) against triangles, as listed; sides a and b are surfaces sa and sb.

    A contact is a place of the other surface that is locally nearest to the vertex; where no neighbour of the
    vertex is nearer, it is a local minimum of the distance, and the vertex is foremost. Seen from inside,
    only the nearest contact of a vertex counts, and no deeper than half the reach; the sweep sorts that out
    once the pair is done. Spheres meet the vertices of deformable surfaces elsewhere.
    """
    triangles, normals, radii, owns = topology.triangles, boxes.normal, topology.radius, topology.owns
    for at in range(min(near.counts[0], near.vertices.shape[0])):
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
        if feature != FACE and distance > _TOUCHING * length(minus(b, a)):
            normal = scaled(gap, (-1.0 if inside else 1.0) / distance)
        foremost = radius > 0.0 or vertex_is_closest(
            v, scaled(normal, -1.0), CONE, topology.ring_start, topology.ring, points
        )
        spot = next_row(found.counter, found.distance)
        if spot < 0:
            continue
        found.foremost[spot] = foremost
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
    sa: int, sb: int, reach: float, begin: int, points: Array, topology: Topology, boxes: Boxes, near: Near,
    found: Found,
) -> None:  # fmt: skip
    """Edges of surface sa against edges of surface sb, as listed, where their insides are closest.

    Edges that run side by side, or in what is nearly flat, only count where no vertex that was found from
    number `begin` on is nearer: elsewhere it is enough to hold the vertices.
    """
    edges, normals, least = topology.edges, boxes.normal, inf
    for k in range(begin, min(found.counter[0], found.distance.shape[0])):
        if found.depth[k] == 0.0:
            least = min(least, found.distance[k])
    for at in range(near.counts[1]):
        e, f = near.edges[at, 0], near.edges[at, 1]
        e0, e1, f0, f1 = edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1]
        p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
        s, t, sine = closest_on_lines(p0, p1, q0, q1)
        along_e, along_f = minus(p1, p0), minus(q1, q0)
        p, q = add(p0, scaled(along_e, s)), add(q0, scaled(along_f, t))
        gap = minus(p, q)
        out_e, out_f = edge_normal(e, topology.sides, normals), edge_normal(f, topology.sides, normals)
        normal = unit(cross(along_e, along_f))
        if dot(normal, minus(out_f, out_e)) < 0.0:
            normal = scaled(normal, -1.0)
        if dot(out_e, normal) >= 0.0 or dot(out_f, normal) <= 0.0:
            continue
        distance = dot(gap, normal)
        if distance < -0.5 * reach:
            continue
        back = scaled(normal, -1.0)
        fall = min(
            fall_away(f, q, along_f, normal, topology.opposite, points),
            fall_away(e, p, along_e, back, topology.opposite, points),
        )
        if fall < 0.0:
            continue
        foremost = fall > RIDGE and sine >= _PARALLEL
        if not foremost and distance >= least:
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
        found.foremost[spot] = foremost
        write(found.a, found.a_weights, spot, (e0, e1, e1), (1.0 - s, s, 0.0))
        write(found.b, found.b_weights, spot, (f0, f1, f1), (1.0 - t, t, 0.0))
        write_pair(found.normal, found.pair, spot, normal, sa, sb)
        n = topology.radius.shape[0]
        found.key[spot] = (n + e) * features(topology) + n + f


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
    found.foremost[spot] = True
    write(found.a, found.a_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
    write(found.b, found.b_weights, spot, (w, w, w), (1.0, 0.0, 0.0))
    write_pair(found.normal, found.pair, spot, scaled(gap, 1.0 / centres), sa, sb)
    found.key[spot] = v * features(topology) + w


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
