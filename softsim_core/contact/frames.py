"""Directions, gaps and slips of contacts after free motion."""

from __future__ import annotations

from math import sqrt

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.compile import kernel


@kernel
def contact_frames(
    vertices: IndexArray,
    shares: Array,
    normal: Array,
    distance: Array,
    points: Array,
    moved: Array,
    rolled: Array,
    apart: float,
    directions: Array,
    gap: Array,
    middle: Array,
) -> None:
    """Fill directions, gaps and middles of k contacts.

    Args:
        vertices: Vertices of both sides, shape (k, 6).
        shares: Their shares, those of the second side negative, shape (k, 6).
        normal: From the second side to the first, shape (k, 3).
        distance: Gaps at the start of the step in [m], shape (k,).
        points: Vertex positions in [m], shape (v, 3).
        moved: How far they move freely in [m], shape (v, 3).
        rolled: Radius times rotation vector of spheres in [m], zeros elsewhere, shape (v, 3).
        apart: Contact distance in [m].
        directions: Filled: normal and two tangents, shape (k, 3, 3); the same normal gives the same tangents.
        gap: Filled: the gap beyond the contact distance after free motion, then the slips, in [m], (k, 3).
        middle: Filled: half-way between the two sides in [m], shape (k, 3).
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
            slip = 0.0
            for q in range(6):
                slip += shares[c, q] * moved[vertices[c, q], i]
                middle[c, i] += 0.5 * abs(shares[c, q]) * points[vertices[c, q], i]
            for v in roll:
                slip -= rolled[v, a] * n[b] - rolled[v, b] * n[a]
            for d in range(3):
                gap[c, d] += directions[c, d, i] * slip
        gap[c, 0] += distance[c] - apart
