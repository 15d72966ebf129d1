"""Constraint rows of contacts: directions, gaps and slips, and coefficients on the coordinates."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.contact.compile import kernel

CORNERS = 6
"""Largest number of vertices of a contact, three on each side."""

NODES = 4
"""Number of nodes that carry a soft vertex."""


class Carried(NamedTuple):
    """Carrier of each collision vertex.

    Attributes:
        soft: Whether nodes carry it, shape (v,).
        nodes, weights: These nodes and their weights, shape (v, 4).
        radius: Radius in [m] of the sphere whose centre it is, else 0, shape (v,).
        rigid: Free rigid body that carries it, or -1, shape (v,).
        reduced: Reduced coordinates that move it, -1 after the last, shape (v, w).
    """

    soft: BoolArray
    nodes: IndexArray
    weights: Array
    radius: Array
    rigid: IndexArray
    reduced: IndexArray


class Motions(NamedTuple):
    """Motion of the vertices' carriers: rigid bodies, frames and joints.

    Attributes:
        rigid_positions: Centres of the free rigid bodies in [m], shape (r, 3).
        angular, linear, origin: Motion subspace of the reduced coordinates, shape (b, 3) each.
        nodes: Number of nodes of the model: reduced coordinate b has place nodes + b in a row.
    """

    rigid_positions: Array
    angular: Array
    linear: Array
    origin: Array
    nodes: int


@kernel
def contact_rows(
    vertices: IndexArray,
    shares: Array,
    directions: Array,
    points: Array,
    carried: Carried,
    motions: Motions,
    start: IndexArray,
    place: IndexArray,
    coefficient: Array,
    on_rigid: Array,
) -> int:
    """Fill three rows per contact and return the number of entries.

    Args:
        vertices: Vertices of both sides, shape (k, 6).
        shares: Weights of these vertices, negative on the second side, shape (k, 6).
        directions: Normal, from the second side to the first, and tangents, shape (k, 3, 3).
        points: Vertex positions in [m], shape (v, 3).
        carried: Carriers of the vertices.
        motions: Motion of the carriers.
        start: Filled: first entry of each row, shape (3 k + 1,).
        place: Filled: node, or `nodes` + reduced coordinate.
        coefficient: Filled, shape (.., 3).
        on_rigid: Added to: velocity and spin of the rigid bodies, shape (3 k, 6 r).
    """
    rigid_positions, nodes = motions.rigid_positions, motions.nodes
    angular, linear, origin = motions.angular, motions.linear, motions.origin
    count = 0
    start[0] = 0
    for c in range(len(vertices)):
        for d in range(3):
            row = 3 * c + d
            x, y, z = directions[c, d, 0], directions[c, d, 1], directions[c, d, 2]
            for k in range(6):
                share, v = shares[c, k], vertices[c, k]
                if share == 0.0:
                    continue
                if carried.soft[v]:
                    for i in range(4):
                        weight = share * carried.weights[v, i]
                        if weight != 0.0:
                            place[count] = carried.nodes[v, i]
                            coefficient[count, 0] = weight * x
                            coefficient[count, 1] = weight * y
                            coefficient[count, 2] = weight * z
                            count += 1
                    continue
                out = -carried.radius[v] if k < 3 else carried.radius[v]
                px = points[v, 0] + out * directions[c, 0, 0]
                py = points[v, 1] + out * directions[c, 0, 1]
                pz = points[v, 2] + out * directions[c, 0, 2]
                r = carried.rigid[v]
                if r >= 0:
                    lx, ly, lz = (
                        px - rigid_positions[r, 0],
                        py - rigid_positions[r, 1],
                        pz - rigid_positions[r, 2],
                    )
                    on_rigid[row, 6 * r] += share * x
                    on_rigid[row, 6 * r + 1] += share * y
                    on_rigid[row, 6 * r + 2] += share * z
                    on_rigid[row, 6 * r + 3] += share * (ly * z - lz * y)
                    on_rigid[row, 6 * r + 4] += share * (lz * x - lx * z)
                    on_rigid[row, 6 * r + 5] += share * (lx * y - ly * x)
                for q in range(carried.reduced.shape[1]):
                    b = carried.reduced[v, q]
                    if b < 0:
                        break
                    ox, oy, oz = px - origin[b, 0], py - origin[b, 1], pz - origin[b, 2]
                    moved = x * (angular[b, 1] * oz - angular[b, 2] * oy + linear[b, 0])
                    moved += y * (angular[b, 2] * ox - angular[b, 0] * oz + linear[b, 1])
                    moved += z * (angular[b, 0] * oy - angular[b, 1] * ox + linear[b, 2])
                    place[count] = nodes + b
                    coefficient[count, 0] = share * moved
                    coefficient[count, 1] = 0.0
                    coefficient[count, 2] = 0.0
                    count += 1
            start[row + 1] = count
    return count


@kernel
def contact_frames(
    vertices: IndexArray,
    shares: Array,
    normal: Array,
    distance: Array,
    points: Array,
    moved: Array,
    ahead: Array,
    rolled: Array,
    apart: float,
    directions: Array,
    gap: Array,
    middle: Array,
) -> None:
    """Fill directions, gaps and midpoints of k contacts.

    Args:
        vertices: Vertices of both sides, shape (k, 6).
        shares: Weights of these vertices, negative on the second side, shape (k, 6).
        normal: From the second side to the first, shape (k, 3).
        distance: Gaps at `points` in [m], shape (k,).
        points: Vertex positions in [m], shape (v, 3).
        moved: Displacement since the start of the step in [m], shape (v, 3).
        ahead: Remaining displacement without contact in [m], shape (v, 3).
        rolled: Radius times rotation vector of spheres in [m], zeros elsewhere, shape (v, 3).
        apart: Contact distance in [m].
        directions: Filled: normal and two tangents, shape (k, 3, 3); equal normals give equal tangents.
        gap: Filled: the gap beyond the contact distance after free motion, then the slips, in [m], (k, 3).
        middle: Filled: midpoint between the two sides in [m], shape (k, 3).
    """
    for c in range(len(normal)):
        n = normal[c]
        least = 0
        for i in (1, 2):
            if abs(n[i]) < abs(n[least]):
                least = i
        j, k = (least + 1) % 3, (least + 2) % 3
        length = sqrt(n[j] * n[j] + n[k] * n[k])
        first, second = directions[c, 1], directions[c, 2]
        first[least], first[j], first[k] = 0.0, n[k] / length, -n[j] / length
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            second[i] = n[a] * first[b] - n[b] * first[a]
            directions[c, 0, i], gap[c, i], middle[c, i] = n[i], 0.0, 0.0
        roll = vertices[c, 0], vertices[c, 3]
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            slip = way = 0.0
            for q in range(6):
                v = vertices[c, q]
                slip += shares[c, q] * moved[v, i]
                way += shares[c, q] * ahead[v, i]
                middle[c, i] += 0.5 * abs(shares[c, q]) * points[v, i]
            for v in roll:
                slip -= rolled[v, a] * n[b] - rolled[v, b] * n[a]
            gap[c, 0] += n[i] * way
            for d in range(1, 3):
                gap[c, d] += directions[c, d, i] * (slip + way)
        gap[c, 0] += distance[c] - apart


@kernel
def gaps_after(vertices: IndexArray, shares: Array, normal: Array, gap: Array, moved: Array) -> Array:
    """Return the gaps of contacts after a motion, as linearised, in [m], shape (k,).

    Args:
        vertices: Vertices of both sides, shape (k, 6).
        shares: Weights of these vertices, negative on the second side, shape (k, 6).
        normal: From the second side to the first, shape (k, 3).
        gap: Gaps before the motion in [m], shape (k,).
        moved: Displacement of the vertices in [m], shape (v, 3).
    """
    gaps = gap.copy()
    for c in range(len(normal)):
        for q in range(6):
            v, share = vertices[c, q], shares[c, q]
            for i in range(3):
                gaps[c] += share * normal[c, i] * moved[v, i]
    return gaps
