"""Where two triangles of different surfaces are closest: vertex against triangle, edge against edge."""

from __future__ import annotations

from math import acos

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.boxes import Boxes
from softsim_core.contact.closest import FACE, closest_on_lines, closest_on_triangle
from softsim_core.contact.compile import kernel
from softsim_core.contact.found import Found, Near, features, next_row, write, write_pair
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
def meet_vertices(
    sa: int, sb: int, reach: float, points: Array, topology: Topology, boxes: Boxes, near: Near, found: Found
) -> None:
    """Vertices (and spheres) against triangles, as listed; sides a and b are surfaces sa and sb.

    A contact is a local minimum of the distance. Seen from inside, only the nearest contact of a vertex
    counts, and no deeper than half the reach; the sweep sorts that out once the pair is done.
    """
    triangles, normals, radii, owns = topology.triangles, boxes.normal, topology.radius, topology.owns
    for at in range(near.counts[0]):
        v, t, first = near.vertices[at, 0], near.vertices[at, 1], near.vertices[at, 2] == 0
        p = row(points, v)
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a, b, c = row(points, i), row(points, j), row(points, k)
        radius = radii[v]
        limit = reach + radius
        outward = row(normals, t)
        if abs(dot(minus(p, a), outward)) > limit:
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
        if edge >= 0:
            outward = edge_normal(edge, topology.sides, normals)
        elif vertex >= 0:
            outward = vertex_normal(vertex, points, topology.fan_start, topology.fan, triangles, normals)
        inside = dot(gap, outward) < 0.0
        if inside and feature != FACE and topology.closed[sb if first else sa] == 0:
            continue  # behind the rim of an open surface
        boxes.nearest[v, int(inside)] = min(boxes.nearest[v, int(inside)], distance)
        if radius == 0.0 and not _opposed(v, outward, topology.fan_start, topology.fan, normals):
            continue
        if inside and distance > 0.5 * reach:
            continue
        boxes.nearest[v, 2] = min(boxes.nearest[v, 2], distance)
        if vertex >= 0 and radius == 0.0 and not first:
            continue  # two vertices: met from the first surface
        if edge >= 0 and not _edge_is_closest(edge, q, gap, _EXACT, topology.opposite, points):
            continue
        if vertex >= 0 and not _vertex_is_closest(
            vertex, gap, _EXACT, topology.ring_start, topology.ring, points
        ):
            continue
        normal = unit(outward)
        if feature != FACE and distance > 1e-9:
            normal = scaled(gap, (-1.0 if inside else 1.0) / distance)
        if radius == 0.0 and not _vertex_is_closest(
            v, scaled(normal, -1.0), _CONE, topology.ring_start, topology.ring, points
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
        if sine < _PARALLEL or min(s, t) <= _EXACT or max(s, t) >= 1.0 - _EXACT:
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
        if not _is_ridge(f, q, normal, topology.opposite, points):
            continue
        if not _is_ridge(e, p, scaled(normal, -1.0), topology.opposite, points):
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


@kernel
def meet_spheres(
    v: int, w: int, sa: int, sb: int, reach: float, points: Array, topology: Topology, found: Found
) -> None:
    """Sphere v of surface sa against sphere w of surface sb."""
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


@kernel
def edge_normal(edge: int, sides: IndexArray, normals: Array) -> Vector:
    """Sum of the unit normals of the edge's triangles."""
    first = row(normals, sides[edge, 0])
    second = sides[edge, 1]
    return add(first, row(normals, second)) if second >= 0 else first


@kernel
def vertex_normal(
    v: int, points: Array, fan_start: IndexArray, fan: IndexArray, triangles: IndexArray, normals: Array
) -> Vector:
    """Sum of the normals around a vertex times the angles there.

    Source: Baerentzen and Aanaes 2005: its sign tells inside from outside wherever v is the closest point.
    """
    total = (0.0, 0.0, 0.0)
    p = row(points, v)
    for at in range(fan_start[v], fan_start[v + 1]):
        t = fan[at]
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        second, third = (j, k) if i == v else (k, i) if j == v else (i, j)
        cosine = dot(unit(minus(row(points, second), p)), unit(minus(row(points, third), p)))
        total = add(total, scaled(row(normals, t), acos(min(1.0, max(-1.0, cosine)))))
    return total


@kernel
def _opposed(v: int, outward: Vector, fan_start: IndexArray, fan: IndexArray, normals: Array) -> bool:
    """Whether a triangle around v faces the outward direction of the other surface."""
    limit = -1e-3 * length(outward)
    for at in range(fan_start[v], fan_start[v + 1]):  # noqa: SIM110 - Numba compiles no generators
        if dot(row(normals, fan[at]), outward) < limit:
            return True
    return False


@kernel
def _vertex_is_closest(
    v: int, direction: Vector, sine: float, ring_start: IndexArray, ring: IndexArray, points: Array
) -> bool:
    """Whether no neighbour of v lies farther along `direction`, by up to `sine` of its distance."""
    p = row(points, v)
    limit = sine * length(direction)
    for at in range(ring_start[v], ring_start[v + 1]):
        off = minus(row(points, ring[at]), p)
        if dot(off, direction) > limit * length(off):
            return False
    return True


@kernel
def _edge_is_closest(
    edge: int, at: Vector, direction: Vector, sine: float, opposite: IndexArray, points: Array
) -> bool:
    """Whether the edge's triangles do not rise along `direction` from the point `at` of the edge."""
    limit = sine * length(direction)
    for side in range(2):
        third = opposite[edge, side]
        if third >= 0:
            off = minus(row(points, third), at)
            if dot(off, direction) > limit * length(off):
                return False
    return True


@kernel
def _is_ridge(edge: int, at: Vector, direction: Vector, opposite: IndexArray, points: Array) -> bool:
    """Whether the edge's triangles fall away from the unit vector `direction`, and it is not flat."""
    if opposite[edge, 1] < 0:
        return _edge_is_closest(edge, at, direction, _CONE, opposite, points)
    fall = 0.0
    for side in range(2):
        off = minus(row(points, opposite[edge, side]), at)
        rise = dot(off, direction) / length(off)
        if rise > _CONE:
            return False
        fall -= rise
    return fall > _RIDGE
