"""Triangulations of the plane from lines of points: stitching, edge flips, smoothing; deterministic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.arrays import Array, IndexArray, unique_pairs

_TIE = 1.0e-9  # relative; decides equal lengths the same way on every machine


def stitch(points: Array, left: Sequence[int], right: Sequence[int]) -> list[tuple[int, int, int]]:
    """Triangles of the strip between two lines of points, the shorter diagonal first.

    Args:
        points: Coordinates, shape (n, 2).
        left: Indices of the points of one line, in the direction of travel, at its left hand.
        right: Indices of the points of the other line, same direction; end points may be shared.

    Returns:
        Counter-clockwise index triples.
    """
    triangles = []
    i = j = 0
    while i + 1 < len(left) or j + 1 < len(right):
        can_left, can_right = i + 1 < len(left), j + 1 < len(right)
        if can_left and can_right:
            ahead_left = np.linalg.norm(points[left[i + 1]] - points[right[j]])
            ahead_right = np.linalg.norm(points[right[j + 1]] - points[left[i]])
            can_left = bool(ahead_left < ahead_right * (1.0 - _TIE))
        if can_left:
            triangles.append((left[i], right[j], left[i + 1]))
            i += 1
        else:
            triangles.append((left[i], right[j], right[j + 1]))
            j += 1
    return [triangle for triangle in triangles if len(set(triangle)) == 3]


def flip_to_delaunay(points: Array, triangles: Sequence[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Interior edges flipped until opposite angles add up to at most 180 degrees (Lawson 1977)."""
    current = [tuple(triangle) for triangle in triangles]
    for _ in range(10 * len(current)):
        pair = _first_illegal_edge(points, current)
        if pair is None:
            break
        one, other, a, b, c, d = pair
        current[one], current[other] = (a, d, c), (d, b, c)
    return [(int(a), int(b), int(c)) for a, b, c in current]


def _first_illegal_edge(
    points: Array, triangles: Sequence[tuple[int, ...]]
) -> tuple[int, int, int, int, int, int] | None:
    """Triangles (one, other) and their edge a-b to flip, with apexes c (left of a-b) and d."""
    owner: dict[tuple[int, int], tuple[int, int]] = {}
    for index, (a, b, c) in enumerate(triangles):
        for start, end, apex in ((a, b, c), (b, c, a), (c, a, b)):
            owner[start, end] = (index, apex)
    for (a, b), (one, c) in owner.items():
        if a < b and (b, a) in owner:
            other, d = owner[b, a]
            if _angle(points, a, c, b) + _angle(points, a, d, b) > np.pi + 1.0e-6:
                return one, other, a, b, c, d
    return None


def _angle(points: Array, a: int, apex: int, b: int) -> float:
    u, v = points[a] - points[apex], points[b] - points[apex]
    return float(np.arctan2(abs(u[0] * v[1] - u[1] * v[0]), u @ v))


def smooth(points: Array, triangles: IndexArray, movable: Array, sweeps: int = 20) -> Array:
    """Points moved towards the mean of their neighbours, each along its own projection (Laplace smoothing).

    Args:
        points: Coordinates, shape (n, 2).
        triangles: Index triples, shape (k, 3).
        movable: Projection of a point's motion, shape (n, 2, 2): identity for free points, zero for fixed
            ones, t tᵀ for points that slide along the unit vector t.
        sweeps: Number of passes over all points (all points move at once in a pass).

    Returns:
        New coordinates, shape (n, 2).
    """
    edges = unique_pairs(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))
    start = np.concatenate([edges[:, 0], edges[:, 1]])
    end = np.concatenate([edges[:, 1], edges[:, 0]])
    degree = np.bincount(start, minlength=len(points))[:, None]
    for _ in range(sweeps):
        mean = np.zeros_like(points)
        np.add.at(mean, start, points[end])
        points = points + 0.5 * np.einsum("nij,nj->ni", movable, mean / degree - points)
    return points
