"""Rows of contacts: what a unit of force along a contact's normal and tangents does to what carries it."""

from __future__ import annotations

from typing import NamedTuple

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.contact.compile import kernel

MOST_ENTRIES = 48
"""Entries of a row at most: six vertices of four nodes or, on a frame, six border unknowns each."""


class Carried(NamedTuple):
    """What carries each collision vertex.

    Attributes:
        soft: Whether nodes carry it, shape (v,).
        nodes, weights: These nodes and their shares, shape (v, 4).
        radius: Radius in [m] of the sphere whose centre it is, else 0, shape (v,).
        rigid: Free rigid body that carries it, or -1, shape (v,).
        border: Border unknowns that move it, -1 behind the last, shape (v, 6).
    """

    soft: BoolArray
    nodes: IndexArray
    weights: Array
    radius: Array
    rigid: IndexArray
    border: IndexArray


@kernel
def contact_rows(
    vertices: IndexArray,
    shares: Array,
    directions: Array,
    points: Array,
    carried: Carried,
    rigid_positions: Array,
    angular: Array,
    linear: Array,
    origin: Array,
    nodes: int,
    start: IndexArray,
    place: IndexArray,
    coefficient: Array,
    on_rigid: Array,
) -> int:
    """Fill three rows a contact; returns the number of entries.

    Args:
        vertices: Vertices of both sides, shape (k, 6).
        shares: Their shares, those of the second side negative, shape (k, 6).
        directions: Normal, from the second side to the first, and tangents, shape (k, 3, 3).
        points: Vertex positions in [m], shape (v, 3).
        carried: What carries the vertices.
        rigid_positions: Centres of the free rigid bodies in [m], shape (r, 3).
        angular: With `linear` and `origin`: screws of the border unknowns, shape (b, 3) each.
        linear: See `angular`.
        origin: See `angular`.
        nodes: Number of nodes of the model.
        start: Filled: begin of each row's entries, shape (3 k + 1,).
        place: Filled: node, or `nodes` + border unknown.
        coefficient: Filled, shape (.., 3).
        on_rigid: Added to: velocity and spin of the rigid bodies, shape (3 k, 6 r).
    """
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
                for q in range(6):
                    b = carried.border[v, q]
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
