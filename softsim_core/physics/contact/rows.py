"""Constraint rows of contacts: directions, gaps and slips, and coefficients on the coordinates."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.contact.compile import kernel
from softsim_core.physics.contact.detection import Proximities

CORNERS = 6
"""Largest number of vertices of a contact, three on each side."""

NODES = 4
"""Number of nodes that carry a soft vertex."""

KEYS = 1 << 52
"""Keys of contacts are reduced modulo this, so that a float64 represents them exactly."""


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
    which: BoolArray,
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
    """Fill three rows for each of the chosen contacts and return the number of entries.

    Args:
        which: The chosen contacts, shape (k,).
        vertices: Vertices of both sides, shape (k, 6).
        shares: Weights of these vertices, negative on the second side, shape (k, 6).
        directions: Normal, from the second side to the first, and tangents, shape (k, 3, 3).
        points: Vertex positions in [m], shape (v, 3).
        carried: Carriers of the vertices.
        motions: Motion of the carriers.
        start: Filled: first entry of each row, shape (3 w + 1,) for w chosen contacts.
        place: Filled: node, or `nodes` + reduced coordinate.
        coefficient: Filled, shape (.., 3).
        on_rigid: Added to: velocity and spin of the rigid bodies, shape (3 w, 6 r).
    """
    rigid_positions, nodes = motions.rigid_positions, motions.nodes
    angular, linear, origin = motions.angular, motions.linear, motions.origin
    count, row = 0, -1
    start[0] = 0
    for c in range(len(vertices)):
        if not which[c]:
            continue
        for d in range(3):
            row += 1
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


class ContactArrays(NamedTuple):
    """Data of k contacts for their rows; for the fields see LinearisedContacts."""

    vertices: IndexArray
    shares: Array
    gap: Array
    directions: Array
    points: Array
    friction: Array
    keys: Array
    closing: BoolArray
    forces: Array


def allocate_contacts(count: int) -> ContactArrays:
    """Return uninitialised arrays for `count` contacts."""
    return ContactArrays(
        np.empty((count, 6), np.int64),
        np.empty((count, 6)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.bool_),
        np.empty((count, 3)),
    )


class VertexWays(NamedTuple):
    """Positions and displacements of the collision vertices in [m], shape (v, 3) each.

    Attributes:
        points: Positions.
        moved: Displacement since the start of the step.
        ahead: Remaining displacement without contact.
        slides: Displacement to the end that is foreseen.
        rolled: Radius times rotation vector of spheres, zeros elsewhere.
    """

    points: Array
    moved: Array
    ahead: Array
    slides: Array
    rolled: Array


@kernel
def contact_frames(
    near: Proximities, ways: VertexWays, friction: Array, apart: float, closing: float, warm_start: Array,
    contacts: ContactArrays,
) -> None:  # fmt: skip
    """Fill the data of k contacts; equal normals give equal tangents.

    Args:
        near: Closest points of the contacts.
        ways: Positions and displacements of the vertices.
        friction: Coulomb coefficient of each pair of surfaces, shape (s, s).
        apart: Contact distance in [m].
        closing: Gap beyond the contact distance in [m] below which a contact is foreseen to close.
        warm_start: Keys, ascending, and forces of earlier contacts; see State.warm_start.
        contacts: Filled.
    """
    vertices, shares, gap, directions = contacts.vertices, contacts.shares, contacts.gap, contacts.directions
    points, moved, ahead, rolled, middle = ways.points, ways.moved, ways.ahead, ways.rolled, contacts.points
    for c in range(len(near.distance)):
        n = near.normal[c]
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
            vertices[c, i], vertices[c, 3 + i] = near.a[c, i], near.b[c, i]
            shares[c, i], shares[c, 3 + i] = near.a_weights[c, i], -near.b_weights[c, i]
        roll = vertices[c, 0], vertices[c, 3]
        foreseen = near.distance[c] - apart
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            slip = way = 0.0
            for q in range(6):
                v = vertices[c, q]
                slip += shares[c, q] * moved[v, i]
                way += shares[c, q] * ahead[v, i]
                foreseen += shares[c, q] * n[i] * ways.slides[v, i]
                middle[c, i] += 0.5 * abs(shares[c, q]) * points[v, i]
            for v in roll:
                slip -= rolled[v, a] * n[b] - rolled[v, b] * n[a]
            gap[c, 0] += n[i] * way
            for d in range(1, 3):
                gap[c, d] += directions[c, d, i] * (slip + way)
        gap[c, 0] += near.distance[c] - apart
        contacts.friction[c] = friction[near.pair[c, 0], near.pair[c, 1]]
        contacts.closing[c] = foreseen < closing
        contacts.keys[c] = near.key[c] % KEYS
        contacts.forces[c] = 0.0
        place = _first_at_least(contacts.keys[c], warm_start)
        if place < len(warm_start) and warm_start[place, 0] == contacts.keys[c]:
            contacts.forces[c] = warm_start[place, 1:]


@kernel
def _first_at_least(key: float, rows: Array) -> int:
    """Return the first of the rows, ascending in column 0, that begins with `key` or more."""
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows[middle, 0] < key:
            low = middle + 1
        else:
            high = middle
    return low


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
