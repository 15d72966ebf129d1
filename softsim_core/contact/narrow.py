"""Where two triangles of different surfaces are closest: vertex against triangle, edge against edge."""

from __future__ import annotations

from math import acos

from softsim_core.arrays import Array
from softsim_core.contact.boxes import Boxes
from softsim_core.contact.closest import FACE, closest_on_lines, closest_on_triangle
from softsim_core.contact.compile import kernel
from softsim_core.contact.found import Found, key_of, next_row, write, write_pair, write_vertex
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import Vector, add, cross, dot, length, minus, row, scaled, unit

_CONE = 0.1
"""Sine by which a direction may leave the cone of directions in which a feature is the closest part of its
own surface. Some slack keeps all vertices of a face that lies almost flat."""
_EXACT = 1.0e-6
"""The same for the feature on which the closest point was found: only round-off is forgiven."""
_RIDGE = 0.02
"""An edge whose two triangles fall away by less than this (sum of two sines) counts as flat."""
_PARALLEL = 4.0e-4
"""Edges at an angle with a squared sine below this have no contact between their insides."""


@kernel
def meet_vertex(
    v: int,
    t: int,
    sv: int,
    st: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    found: Found,
) -> None:
    """Vertex (or sphere) v of surface sv against triangle t of surface st; sides a, b are in surface order.

    A contact is a local minimum of the distance. Seen from inside, only the nearest contact of a vertex
    counts, and no deeper than half the reach; the sweep sorts that out once the pair is done.
    """
    p = row(points, v)
    i, j, k = topology.triangles[t, 0], topology.triangles[t, 1], topology.triangles[t, 2]
    a, b, c = row(points, i), row(points, j), row(points, k)
    radius = topology.radius[v]
    limit = reach + radius
    face = row(boxes.normal, t)
    if abs(dot(minus(p, a), face)) > limit:
        return
    wi, wj, wk, feature = closest_on_triangle(p, a, b, c)
    q = (
        wi * a[0] + wj * b[0] + wk * c[0],
        wi * a[1] + wj * b[1] + wk * c[1],
        wi * a[2] + wj * b[2] + wk * c[2],
    )
    gap = minus(p, q)
    distance = length(gap)
    if distance > limit:
        return
    if feature != FACE and topology.owns[t, feature] == 0:
        return  # the triangle that owns the edge or corner looks at it
    vertex = topology.triangles[t, feature] if feature < 3 else -1
    edge = topology.triangle_edges[t, feature - 3] if 3 <= feature < FACE else -1

    outward = face
    if edge >= 0:
        outward = edge_normal(edge, topology, boxes)
    elif vertex >= 0:
        outward = vertex_normal(vertex, points, topology, boxes)
    if radius == 0.0 and not _opposed(v, outward, topology, boxes):
        return
    side = dot(gap, outward)
    inside = side < 0.0
    if inside and (distance > 0.5 * reach or (feature != FACE and topology.closed[st] == 0)):
        return
    boxes.nearest[v] = min(boxes.nearest[v], distance)
    if vertex >= 0 and radius == 0.0 and sv > st:
        return  # two vertices: met from the first surface
    if edge >= 0 and not _edge_is_closest(edge, q, gap, _EXACT, topology, points):
        return
    if vertex >= 0 and not _vertex_is_closest(vertex, gap, _EXACT, topology, points):
        return
    normal = unit(outward)
    if feature != FACE and distance > 1e-9:
        normal = scaled(gap, (-1.0 if inside else 1.0) / distance)
    if radius == 0.0 and not _vertex_is_closest(v, scaled(normal, -1.0), _CONE, topology, points):
        return

    at = next_row(found)
    if at < 0:
        return
    found.distance[at] = (-distance if inside else distance) - radius
    found.depth[at] = distance if inside else 0.0
    found.seeker[at] = v
    feature_of_triangle = topology.radius.shape[0] + topology.edges.shape[0] + t
    if edge >= 0:
        feature_of_triangle = topology.radius.shape[0] + edge
    elif vertex >= 0:
        feature_of_triangle = vertex
    if sv < st:
        write_vertex(found.a, found.a_weights, at, v)
        write(found.b, found.b_weights, at, (i, j, k), (wi, wj, wk))
        write_pair(found, at, sv, st, normal, key_of(v, feature_of_triangle, topology))
    else:
        write(found.a, found.a_weights, at, (i, j, k), (wi, wj, wk))
        write_vertex(found.b, found.b_weights, at, v)
        write_pair(found, at, st, sv, scaled(normal, -1.0), key_of(feature_of_triangle, v, topology))


@kernel
def meet_edges(
    e: int,
    f: int,
    sa: int,
    sb: int,
    reach: float,
    points: Array,
    topology: Topology,
    boxes: Boxes,
    found: Found,
) -> None:
    """Edge e of surface sa against edge f of surface sb (sa < sb), where their insides are closest."""
    e0, e1, f0, f1 = topology.edges[e, 0], topology.edges[e, 1], topology.edges[f, 0], topology.edges[f, 1]
    p0, p1, q0, q1 = row(points, e0), row(points, e1), row(points, f0), row(points, f1)
    s, t, sine = closest_on_lines(p0, p1, q0, q1)
    if sine < _PARALLEL or s <= 1e-6 or s >= 1.0 - 1e-6 or t <= 1e-6 or t >= 1.0 - 1e-6:
        return
    along_e, along_f = minus(p1, p0), minus(q1, q0)
    p, q = add(p0, scaled(along_e, s)), add(q0, scaled(along_f, t))
    gap = minus(p, q)
    if dot(gap, gap) > reach * reach:
        return
    out_e, out_f = edge_normal(e, topology, boxes), edge_normal(f, topology, boxes)
    normal = unit(cross(along_e, along_f))
    if dot(normal, minus(out_f, out_e)) < 0.0:
        normal = scaled(normal, -1.0)
    if dot(out_e, normal) >= 0.0 or dot(out_f, normal) <= 0.0:
        return
    distance = dot(gap, normal)
    if distance < -0.5 * reach:
        return
    if not _is_ridge(f, q, normal, topology, points):
        return
    inward = scaled(normal, -1.0)
    if not _is_ridge(e, p, inward, topology, points):
        return
    at = next_row(found)
    if at < 0:
        return
    found.distance[at] = distance
    found.depth[at] = 0.0
    found.seeker[at] = -1
    write(found.a, found.a_weights, at, (e0, e1, e1), (1.0 - s, s, 0.0))
    write(found.b, found.b_weights, at, (f0, f1, f1), (1.0 - t, t, 0.0))
    n = topology.radius.shape[0]
    write_pair(found, at, sa, sb, normal, key_of(n + e, n + f, topology))


@kernel
def meet_spheres(
    v: int, w: int, sa: int, sb: int, reach: float, points: Array, topology: Topology, found: Found
) -> None:
    """Sphere v of surface sa against sphere w of surface sb (sa < sb)."""
    gap = minus(row(points, v), row(points, w))
    centres = length(gap)
    distance = centres - topology.radius[v] - topology.radius[w]
    if distance > reach or centres <= 0.0:
        return
    at = next_row(found)
    if at < 0:
        return
    found.distance[at] = distance
    found.depth[at] = 0.0
    found.seeker[at] = -1
    write_vertex(found.a, found.a_weights, at, v)
    write_vertex(found.b, found.b_weights, at, w)
    write_pair(found, at, sa, sb, scaled(gap, 1.0 / centres), key_of(v, w, topology))


@kernel
def edge_normal(edge: int, topology: Topology, boxes: Boxes) -> Vector:
    """Sum of the unit normals of the edge's triangles."""
    first = row(boxes.normal, topology.sides[edge, 0])
    second = topology.sides[edge, 1]
    return add(first, row(boxes.normal, second)) if second >= 0 else first


@kernel
def vertex_normal(v: int, points: Array, topology: Topology, boxes: Boxes) -> Vector:
    """Sum of the normals around a vertex times the angles there.

    Source: Baerentzen and Aanaes 2005: its sign tells inside from outside wherever v is the closest point.
    """
    total = (0.0, 0.0, 0.0)
    p = row(points, v)
    for at in range(topology.fan_start[v], topology.fan_start[v + 1]):
        t = topology.fan[at]
        i, j, k = topology.triangles[t, 0], topology.triangles[t, 1], topology.triangles[t, 2]
        second, third = (j, k) if i == v else (k, i) if j == v else (i, j)
        cosine = dot(unit(minus(row(points, second), p)), unit(minus(row(points, third), p)))
        total = add(total, scaled(row(boxes.normal, t), acos(min(1.0, max(-1.0, cosine)))))
    return total


@kernel
def _opposed(v: int, outward: Vector, topology: Topology, boxes: Boxes) -> bool:
    """Whether a triangle around v faces the outward direction of the other surface."""
    limit = -1e-3 * length(outward)
    for at in range(topology.fan_start[v], topology.fan_start[v + 1]):
        if dot(row(boxes.normal, topology.fan[at]), outward) < limit:
            return True
    return False


@kernel
def _vertex_is_closest(v: int, direction: Vector, sine: float, topology: Topology, points: Array) -> bool:
    """Whether no neighbour of v lies farther along `direction`, by up to `sine` of its distance."""
    p = row(points, v)
    limit = sine * length(direction)
    for at in range(topology.ring_start[v], topology.ring_start[v + 1]):
        off = minus(row(points, topology.ring[at]), p)
        if dot(off, direction) > limit * length(off):
            return False
    return True


@kernel
def _edge_is_closest(
    edge: int, at: Vector, direction: Vector, sine: float, topology: Topology, points: Array
) -> bool:
    """Whether the edge's triangles do not rise along `direction` from the point `at` of the edge."""
    limit = sine * length(direction)
    for side in range(2):
        third = topology.opposite[edge, side]
        if third >= 0:
            off = minus(row(points, third), at)
            if dot(off, direction) > limit * length(off):
                return False
    return True


@kernel
def _is_ridge(edge: int, at: Vector, direction: Vector, topology: Topology, points: Array) -> bool:
    """Whether the edge's triangles fall away from the unit vector `direction`, and it is not flat."""
    if topology.opposite[edge, 1] < 0:
        return _edge_is_closest(edge, at, direction, _CONE, topology, points)
    fall = 0.0
    for side in range(2):
        off = minus(row(points, topology.opposite[edge, side]), at)
        rise = dot(off, direction) / length(off)
        if rise > _CONE:
            return False
        fall -= rise
    return fall > _RIDGE
