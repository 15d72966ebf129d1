"""Holes in a surface: the loops of its open edges, and triangles that close them."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.meshing.topology import edges_of

_LONG_LOOP = 400
"""Corners above which a hole is closed by a fan around its middle instead of by cutting off ears."""


def hole_loops(triangles: IndexArray) -> list[IndexArray]:
    """Vertices around each hole, in the direction in which triangles that close it run.

    Args:
        triangles: Turned alike where they share an edge, shape (k, 3).
    """
    edges = edges_of(triangles)
    alone = edges.uses[edges.of] == 1
    start = triangles[alone]
    end = np.roll(triangles, -1, axis=1)[alone]
    onward: dict[int, list[int]] = {}
    for a, b in zip(end.tolist(), start.tolist(), strict=True):  # against the triangles
        onward.setdefault(a, []).append(b)
    loops: list[IndexArray] = []
    for first in sorted(onward):
        while onward[first]:
            loops += _walk(first, onward)
    return loops


def _walk(first: int, onward: dict[int, list[int]]) -> list[IndexArray]:
    """Simple loops of a walk along open edges, which are used up."""
    loops, path, place = [], [first], {first: 0}
    while onward.get(path[-1]):
        following = onward[path[-1]].pop()
        if following in place:
            begin = place[following]
            loops.append(np.array(path[begin:], dtype=np.int64))
            for left in path[begin + 1 :]:
                del place[left]
            path = path[: begin + 1]
        else:
            place[following] = len(path)
            path.append(following)
    return [loop for loop in loops if len(loop) > 2]


def loop_size(points: Array, loop: IndexArray) -> float:
    """How far a loop reaches, in the unit of the points: the diagonal of the box around it."""
    return float(np.linalg.norm(np.ptp(points[loop], axis=0)))


def closing(points: Array, loop: IndexArray) -> tuple[Array, IndexArray]:
    """Triangles over a loop.

    Args:
        points: Vertices, shape (n, 3).
        loop: Vertices around the hole, shape (c,), c >= 3.

    Returns:
        New vertices, which are numbered from n on, shape (0 or 1, 3), and triangles, shape (t, 3).
    """
    outline = _flattened(points[loop])
    if len(loop) <= _LONG_LOOP:
        ears = _ears(outline)
        if ears is not None:
            return np.empty((0, 3)), loop[ears]
    middle = np.full(len(loop), len(points))
    return points[loop].mean(axis=0)[None], np.column_stack([loop, np.roll(loop, -1), middle])


def _flattened(outline: Array) -> Array:
    """Corners (c, 3) in the plane across the loop's area vector, counter-clockwise, shape (c, 2)."""
    off = outline - outline.mean(axis=0)
    normal = np.cross(off, np.roll(off, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(normal)
    if not length > 0.0:
        return np.zeros((len(outline), 2))
    normal /= length
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.column_stack([off @ first, off @ np.cross(normal, first)])


def _ears(corners: Array) -> IndexArray | None:
    """A triangulation of a simple polygon, counter-clockwise (c, 2), or None where it is not simple.

    Source: Meisters 1975, Polygons have ears. The roundest ear is cut first.
    """
    left, triangles = list(range(len(corners))), []
    slack = 1.0e-12 * float(np.ptp(corners, axis=0).max()) ** 2
    while len(left) > 3:
        ring = corners[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        twice = _cross(ring - before, after - ring)
        longest = ((after - before) ** 2).sum(axis=1)
        longest = np.maximum(longest, np.maximum(((ring - before) ** 2).sum(1), ((after - ring) ** 2).sum(1)))
        round_first = np.argsort(-twice / np.maximum(longest, 1e-300), kind="stable")
        for ear in round_first.tolist():
            if twice[ear] <= slack:
                return None
            others = np.delete(ring, [ear - 1, ear, (ear + 1) % len(left)], axis=0)
            if not _holds_any(before[ear], ring[ear], after[ear], others):
                break
        else:
            return None
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*triangles, left], dtype=np.int64)


def _holds_any(a: Array, b: Array, c: Array, others: Array) -> bool:
    inside = (_cross(b - a, others - a) >= 0.0) & (_cross(c - b, others - b) >= 0.0)
    return bool((inside & (_cross(a - c, others - c) >= 0.0)).any())


def _cross(u: Array, v: Array) -> Array:
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
