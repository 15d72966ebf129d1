"""Narrow phase: closest points of vertices, triangles, edges and spheres; the search over all pairs."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.detection.broad_phase import (
    Boxes,
    apart,
    beyond,
    compare_trees,
    list_pair,
    list_vertex,
    outside,
    refit,
    segments_apart,
    surface_boxes,
)
from softsim_core.physics.contact.detection.candidates import (
    ContactBuffers,
    Near,
    features,
    interpolate_side,
    move,
    next_row,
    write,
    write_pair,
)
from softsim_core.physics.contact.detection.geometry import (
    CONE,
    EXACT,
    FACE,
    RIDGE,
    Vector,
    add,
    closest_on_lines,
    closest_on_segments,
    closest_on_triangle,
    cross,
    dot,
    edge_is_closest,
    edge_normal,
    fall_away,
    has_opposed_triangle,
    length,
    minus,
    nearest_share,
    outward_at,
    row,
    scale,
    unit,
    vertex_is_closest,
    vertex_normal,
)
from softsim_core.physics.contact.detection.topology import Topology

_PARALLEL = 4.0e-4
"""Squared sine of the angle below which the interiors of two edges have no contact."""
_TOUCHING = 1.0e-7
"""Share of an edge's length below which a gap is too short to define a direction."""


@kernel
def meet_leaves(
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    near: Near,
    found: ContactBuffers,
) -> None:
    """Test the vertices of close leaves against triangles, and list the edges whose interiors are close.

    A triangle tests only the features that it owns, so that no pair of features is tested twice. Fine
    surfaces that move far in a step have about a hundred pairs within reach for each pair that can touch.
    Vertices are therefore tested in batches, and only those edges are listed that are closest between their
    ends.
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
    """Return whether non-parallel edges e0 e1 and f0 f1 are closest between their ends, within `reach`."""
    if segments_apart(points, e0, e1, f0, f1, reach):
        return False
    p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
    s, t, _ = closest_on_lines(p0, p1, q0, q1)
    if min(s, t) <= EXACT or max(s, t) >= 1.0 - EXACT:  # parallel ones, too
        return False
    gap = minus(add(p0, scale(minus(p1, p0), s)), add(q0, scale(minus(q1, q0), t)))
    return bool(dot(gap, gap) <= reach * reach)


@kernel
def meet_vertices(
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    near: Near,
    found: ContactBuffers,
) -> None:
    """Test the listed vertices and spheres against triangles; sides a and b are surfaces sa and sb.

    A contact is a point of the other surface that is locally closest to the vertex. Where no neighbour of the
    vertex is closer, it is a local minimum of the distance, and the contact is foremost. From inside, only
    the nearest contact of a vertex counts, and only up to half the reach deep; `_sift` selects it once the
    pair is done. Spheres are tested against the vertices of deformable surfaces in `meet_corners`.
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
        q = add(add(scale(a, wi), scale(b, wj)), scale(c, wk))
        gap = minus(p, q)
        distance = length(gap)
        if distance > limit:
            continue
        if feature != FACE and owns[t, feature] == 0:
            continue  # the triangle that owns the edge or corner tests it
        vertex = triangles[t, feature] if feature < 3 else -1
        edge = topology.triangle_edges[t, feature - 3] if 3 <= feature < FACE else -1
        outward = outward_at(t, feature, points, topology, normals)
        inside = dot(gap, outward) < 0.0
        if inside and feature != FACE and topology.closed[sb if first else sa] == 0:
            continue  # behind the rim of an open surface
        boxes.nearest[v, int(inside)] = min(boxes.nearest[v, int(inside)], distance)
        if radius == 0.0 and not has_opposed_triangle(v, outward, topology.fan_start, topology.fan, normals):
            continue
        if inside and distance > 0.5 * reach:
            continue
        boxes.nearest[v, 2] = min(boxes.nearest[v, 2], distance)
        if vertex >= 0 and radius == 0.0 and not first:
            continue  # two vertices: tested from the first surface
        if vertex >= 0 and radius > 0.0 and not inside and topology.soft[sb if first else sa] == 1:
            continue  # tested in meet_corners, whether it is the closest point or not
        if edge >= 0 and not edge_is_closest(edge, q, gap, EXACT, topology.opposite, points):
            continue
        if vertex >= 0 and not vertex_is_closest(
            vertex, gap, EXACT, topology.ring_start, topology.ring, points
        ):
            continue
        normal = unit(outward)
        if feature != FACE and distance > _TOUCHING * length(minus(b, a)):
            normal = scale(gap, (-1.0 if inside else 1.0) / distance)
        foremost = radius > 0.0 or vertex_is_closest(
            v, scale(normal, -1.0), CONE, topology.ring_start, topology.ring, points
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
            write_pair(found.normal, found.pair, spot, scale(normal, -1.0), sa, sb)
            found.key[spot] = other * features(topology) + v


@kernel
def meet_edges(
    sa: int, sb: int, reach: float, begin: int, points: Array, topology: Topology, boxes: Boxes, near: Near,
    found: ContactBuffers,
) -> None:  # fmt: skip
    """Test the listed edges of surface sa against those of surface sb where their interiors are closest.

    Nearly parallel edges, and edges in nearly flat areas, count only where no vertex contact from number
    `begin` on is closer; elsewhere it is enough to constrain the vertices.
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
        p, q = add(p0, scale(along_e, s)), add(q0, scale(along_f, t))
        gap = minus(p, q)
        out_e, out_f = edge_normal(e, topology.sides, normals), edge_normal(f, topology.sides, normals)
        normal = unit(cross(along_e, along_f))
        if dot(normal, minus(out_f, out_e)) < 0.0:
            normal = scale(normal, -1.0)
        if dot(out_e, normal) >= 0.0 or dot(out_f, normal) <= 0.0:
            continue
        distance = dot(gap, normal)
        if distance < -0.5 * reach:
            continue
        back = scale(normal, -1.0)
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
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    near: Near,
    found: ContactBuffers,
) -> None:
    """Test the listed spheres against all vertices of a deformable surface within `reach` that face them.

    In a dent as round as the sphere, hardly any vertex is a local minimum of the distance, and the minima
    change from step to step; yet no vertex may enter the sphere.
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
    v: int, w: int, sa: int, sb: int, reach: float, points: Array, topology: Topology, found: ContactBuffers
) -> None:
    """Test sphere v of surface sa against sphere w of surface sb; a vertex is a sphere of radius zero."""
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
    write_pair(found.normal, found.pair, spot, scale(gap, 1.0 / centres), sa, sb)
    found.key[spot] = v * features(topology) + w


_AGAINST = -0.1
"""Cosine below which a normal points the other way."""


@kernel
def leads_out(
    p: Vector, direction: Vector, s: int, reach: float, points: Array, topology: Topology, boxes: Boxes
) -> bool:
    """Return whether surface s, at its point nearest to p, does not face against the unit vector `direction`.

    An edge on the far side of a thin sheet looks as if something in front of the sheet had come through it.
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
    """Return the triangle of surface s nearest to p within `reach`, and its feature there, else -1, -1."""
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
            gap = minus(p, add(add(scale(a, u), scale(b, v)), scale(c, w)))
            squared = dot(gap, gap)
            if squared < least:
                least, nearest, where = squared, t, feature
    return nearest, where


@kernel
def _squared_distance(p: Vector, boxes: Array, i: int) -> float:
    """Return the squared distance of p to box i, 0 inside it."""
    total = 0.0
    for d in range(3):
        off = max(boxes[i, d] - p[d], p[d] - boxes[i, 3 + d], 0.0)
        total += off * off
    return total


class KnownPairs(NamedTuple):
    """Pairs of features, k of them: edges, or a vertex and an edge or a triangle.

    Attributes:
        features: Numbers of the two features in the order vertices, edges, triangles, shape (k, 2).
        surfaces: Numbers of the two surfaces, first < second, shape (k, 2).
        together: Distance in [m] at rest up to which points of the two never meet, shape (k,).
    """

    features: IndexArray
    surfaces: IndexArray
    together: Array


@kernel
def meet_known_pairs(
    pairs: KnownPairs, points: Array, rest: Array, topology: Topology, found: ContactBuffers
) -> None:
    """Find the closest points of known pairs; those that have crossed are left out.

    The closest points of two edges may be their ends. A vertex counts where its closest point is inside the
    edge or triangle; elsewhere another feature of the same surface is closer to it.

    Args:
        pairs: The pairs.
        points: Vertex positions in [m], shape (V, 3).
        rest: Vertex positions at rest in [m], shape (V, 3).
        topology: The surfaces' topology.
        found: Overwritten; large enough for all pairs.
    """
    n, count = topology.radius.shape[0], topology.edges.shape[0]
    found.counter[0] = 0
    for k in range(pairs.features.shape[0]):
        first, second, spot = pairs.features[k, 0], pairs.features[k, 1], found.counter[0]
        if min(first, second) >= n and max(first, second) < n + count:
            _meet_known_edges(pairs, k, points, topology, found)
        elif min(first, second) < n <= max(first, second):
            _meet_known_vertex(pairs, k, points, topology, found)
        if found.counter[0] == spot:
            continue
        found.depth[spot], found.foremost[spot] = 0.0, False
        found.key[spot] = first * features(topology) + second
        apart = minus(
            interpolate_side(found.a, found.a_weights, spot, rest),
            interpolate_side(found.b, found.b_weights, spot, rest),
        )
        if length(apart) <= pairs.together[k]:
            found.counter[0] = spot


@kernel
def _meet_known_edges(
    pairs: KnownPairs, k: int, points: Array, topology: Topology, found: ContactBuffers
) -> None:
    """Add the pair k, two edges, unless they have crossed."""
    edges, n = topology.edges, topology.radius.shape[0]
    e, f = pairs.features[k, 0] - n, pairs.features[k, 1] - n
    e0, e1, f0, f1 = edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1]
    p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
    s, t = closest_on_segments(p0, p1, q0, q1)
    gap = minus(add(p0, scale(minus(p1, p0), s)), add(q0, scale(minus(q1, q0), t)))
    if dot(gap, minus(_outward(f, points, topology), _outward(e, points, topology))) <= 0.0:
        return
    spot = next_row(found.counter, found.distance)
    found.distance[spot], found.seeker[spot] = length(gap), -1
    write(found.a, found.a_weights, spot, (e0, e1, e1), (1.0 - s, s, 0.0))
    write(found.b, found.b_weights, spot, (f0, f1, f1), (1.0 - t, t, 0.0))
    write_pair(found.normal, found.pair, spot, unit(gap), pairs.surfaces[k, 0], pairs.surfaces[k, 1])


@kernel
def _meet_known_vertex(
    pairs: KnownPairs, k: int, points: Array, topology: Topology, found: ContactBuffers
) -> None:
    """Add the pair k, a vertex or sphere and an edge or triangle, if it is in front of that one's inside."""
    n, count, triangles = topology.radius.shape[0], topology.edges.shape[0], topology.triangles
    v, other = min(pairs.features[k]), max(pairs.features[k]) - n
    t = topology.sides[other, 0] if other < count else other - count
    i, j, m = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    p, a, b, c = row(points, v), row(points, i), row(points, j), row(points, m)
    if other < count:
        first, last = topology.edges[other, 0], topology.edges[other, 1]
        share = nearest_share(p, row(points, first), row(points, last))
        inside, outward = 0.0 < share < 1.0, _outward(other, points, topology)
        wi, wj = _weight_on_edge(i, first, last, share), _weight_on_edge(j, first, last, share)
        wk = _weight_on_edge(m, first, last, share)
    else:
        wi, wj, wk, feature = closest_on_triangle(p, a, b, c)
        inside, outward = feature == FACE, cross(minus(b, a), minus(c, a))
    gap = minus(p, add(add(scale(a, wi), scale(b, wj)), scale(c, wk)))
    if not inside or dot(gap, outward) <= 0.0:
        return
    spot = next_row(found.counter, found.distance)
    found.distance[spot], found.seeker[spot] = length(gap) - topology.radius[v], v
    if pairs.features[k, 0] == v:
        write(found.a, found.a_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
        write(found.b, found.b_weights, spot, (i, j, m), (wi, wj, wk))
    else:
        write(found.a, found.a_weights, spot, (i, j, m), (wi, wj, wk))
        write(found.b, found.b_weights, spot, (v, v, v), (1.0, 0.0, 0.0))
        gap = scale(gap, -1.0)
    write_pair(found.normal, found.pair, spot, unit(gap), pairs.surfaces[k, 0], pairs.surfaces[k, 1])


@kernel
def _weight_on_edge(corner: int, first: int, last: int, share: float) -> float:
    """Return the weight of a triangle's corner in the point at `share` of its edge from first to last."""
    if corner == first:
        return 1.0 - share
    return share if corner == last else 0.0


@kernel
def _outward(edge: int, points: Array, topology: Topology) -> Vector:
    """Return the sum of the unit normals of an edge's triangles."""
    total = (0.0, 0.0, 0.0)
    for side in range(2):
        t = topology.sides[edge, side]
        if t >= 0:
            a = row(points, topology.triangles[t, 0])
            b, c = row(points, topology.triangles[t, 1]), row(points, topology.triangles[t, 2])
            total = add(total, unit(cross(minus(b, a), minus(c, a))))
    return total


_SAME = 1.0e-7
"""Share of the triangle's edge below which the points of two contacts of one vertex are identical."""
_CLOSE = 1.5
"""Contact distances below which a sphere is tested against all vertices of a dent, beside the travel."""


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
    found: ContactBuffers,
) -> int:
    """Find the contacts of all pairs of surfaces; return the buffer size that contacts and pairs need.

    Args:
        points: Vertex positions in [m], shape (V, 3).
        rest_points: Vertex positions at rest in [m], shape (V, 3).
        alarm: Largest distance in [m] of surfaces at rest.
        travel: Travel of each surface that is added to it in [m], shape (s,).
        contact_distance: Contact distance in [m]. Two points of one body count only if they are farther apart
            than this in the rest shape.
        topology: The surfaces' topology.
        boxes: Overwritten.
        near: Overwritten.
        found: Overwritten; its counter is the number of contacts.
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
    begin: int,
    end: int,
    least_rest: float,
    points: Array,
    rest_points: Array,
    boxes: Boxes,
    found: ContactBuffers,
) -> int:
    """Retain the valid contacts of one pair of surfaces and return the new end.

    Removed are: contacts from inside whose vertex is outside by its nearest point, or that are not the
    nearest; a second contact of a vertex at the same point (on an edge between coplanar triangles); points of
    one body that are close at rest.
    """
    last = begin
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
            move(k, last, found)
            if v >= 0:
                found.earlier[last], boxes.latest[v] = boxes.latest[v], last
            last += 1
    return last


@kernel
def _squared_gap(k: int, points: Array, found: ContactBuffers) -> float:
    """Return the squared distance between the two points of contact k."""
    between = minus(
        interpolate_side(found.a, found.a_weights, k, points),
        interpolate_side(found.b, found.b_weights, k, points),
    )
    return dot(between, between)


@kernel
def _same_points(k: int, other: int, points: Array, found: ContactBuffers) -> bool:
    """Return whether two contacts have the same points."""
    a = minus(
        interpolate_side(found.a, found.a_weights, k, points),
        interpolate_side(found.a, found.a_weights, other, points),
    )
    b = minus(
        interpolate_side(found.b, found.b_weights, k, points),
        interpolate_side(found.b, found.b_weights, other, points),
    )
    near = _SAME * _SAME * max(_squared_edge(found.a, k, points), _squared_edge(found.b, k, points))
    return dot(a, a) + dot(b, b) < near


@kernel
def _squared_edge(nodes: IndexArray, k: int, points: Array) -> float:
    """Return the squared length of the first edge of one side of contact k; 0 for a vertex."""
    edge = minus(row(points, nodes[k, 1]), row(points, nodes[k, 0]))
    return dot(edge, edge)
