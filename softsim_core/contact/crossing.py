"""Triangles that pass through each other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray

_CHUNK = 256
_PAIRS = 1 << 20
"""So many pairs of boxes are looked at together."""
_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Of a coordinate, with some room: volumes that this may make are none."""
_SHIFTS = 3.0e-5 * np.array(list(itertools.product((1.0, -1.0), repeat=3))) * (1.0, 0.83, 0.71)
"""Small moves, as shares of the smaller surface's size: surfaces that only touch come apart by one of them;
crooked, so that none leads an edge exactly through another one."""


def surfaces_cross(first: Array, second: Array) -> bool:
    """Whether two surfaces cross, and still do where one of them is moved a little, whichever way.

    Args:
        first: Corners of the triangles in [m], shape (k, 3, 3).
        second: Corners of the triangles in [m], shape (m, 3, 3).
    """
    size = min(float(np.linalg.norm(np.ptp(each, axis=(0, 1)))) for each in (first, second))
    return all(_any_crosses(first, second + size * shift) for shift in _SHIFTS)


def self_crossing(corners: Array, triangles: IndexArray) -> tuple[int, int] | None:
    """Return the first two triangles found that have no vertex in common and cross, or None.

    Args:
        corners: Corners in [m], shape (k, 3, 3).
        triangles: Their vertices, shape (k, 3).
    """
    return next(((int(each[0, 0]), int(each[0, 1])) for each in _hits(corners, triangles) if len(each)), None)


def crossings(corners: Array, triangles: IndexArray) -> IndexArray:
    """All pairs of triangles of one surface that have no vertex in common and cross, shape (c, 2), ascending.

    Args:
        corners: Corners in one unit, shape (k, 3, 3).
        triangles: Their vertices, shape (k, 3).
    """
    pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *_hits(corners, triangles)])
    return pairs[np.lexsort(pairs.T[::-1])]


def _hits(corners: Array, triangles: IndexArray) -> Iterator[IndexArray]:
    """Pairs of triangles that cross, some at a time, shape (c, 2)."""
    for i, j in _near_pairs(corners):
        strangers = (triangles[i][:, :, None] != triangles[j][:, None, :]).all(axis=(1, 2))
        i, j = i[strangers], j[strangers]
        hit = _pierce(corners[i], corners[j]) | _pierce(corners[j], corners[i])
        yield np.sort(np.column_stack([i, j])[hit], axis=1)


def _near_pairs(corners: Array) -> Iterator[tuple[IndexArray, IndexArray]]:
    """Pairs of triangles whose boxes have a point in common, each once: a sweep along the longest axis."""
    if not len(corners):
        return
    low, high = corners.min(axis=1), corners.max(axis=1)
    axis = int(np.ptp(corners, axis=(0, 1)).argmax())
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    ahead = np.searchsorted(low[:, axis], high[:, axis], side="right") - np.arange(1, len(order) + 1)
    ends = np.cumsum(ahead)
    start = 0
    while start < len(order):
        stop = max(start + 1, int(np.searchsorted(ends, ends[start] - ahead[start] + _PAIRS, side="right")))
        count = ahead[start:stop]
        i = np.repeat(np.arange(start, stop), count)
        j = i + 1 + np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
        meet = ((low[i] <= high[j]) & (high[i] >= low[j])).all(axis=1)
        yield order[i[meet]], order[j[meet]]
        start = stop


def _any_crosses(first: Array, second: Array) -> bool:
    """Whether a triangle of the first surface crosses one of the second."""
    low, high = second.min(axis=(0, 1)), second.max(axis=(0, 1))
    some = first[((first.min(axis=1) <= high) & (first.max(axis=1) >= low)).all(axis=1)]
    for start in range(0, len(some), _CHUNK):
        part = some[start : start + _CHUNK]
        i, j = _boxes_meet(part, second)
        if (_pierce(part[i], second[j]) | _pierce(second[j], part[i])).any():
            return True
    return False


def _boxes_meet(first: Array, second: Array) -> tuple[IndexArray, IndexArray]:
    """Pairs of triangles whose boxes have a point in common."""
    near = np.ones((len(first), len(second)), dtype=bool)
    for axis in range(3):
        a, b = first[:, None, :, axis], second[:, :, axis]
        near &= (a.min(axis=2) <= b.max(axis=1)) & (a.max(axis=2) >= b.min(axis=1))
    i, j = np.nonzero(near)
    return i, j


def _pierce(edges_of: Array, faces: Array) -> BoolArray:
    """Whether an edge of the first triangle passes through the second, shapes (p, 3, 3).

    Triangles of one plane, which are so up to rounding, do not.
    """
    a, b, c = faces[:, None, 0], faces[:, None, 1], faces[:, None, 2]
    start, end = edges_of, np.roll(edges_of, -1, axis=1)
    both = np.concatenate([edges_of, faces], axis=1)
    sizes = np.ptp(both, axis=1).max(axis=1, initial=0.0)
    noise = (_ROUNDING * np.abs(both).max(axis=(1, 2), initial=0.0) * sizes**2)[:, None]
    one, other = _volume(a, b, c, start), _volume(a, b, c, end)
    apart = (np.minimum(one, other) < -noise) & (np.maximum(one, other) > noise)
    turns = np.stack(
        [_volume(start, end, a, b), _volume(start, end, b, c), _volume(start, end, c, a)], axis=-1
    )
    through = (turns > noise[..., None]).all(axis=-1) | (turns < -noise[..., None]).all(axis=-1)
    return np.asarray((apart & through).any(axis=1))


def _volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volume of tetrahedra (..., 3)."""
    return np.asarray(np.sum(np.cross(b - a, c - a) * (d - a), axis=-1))
