"""How far two surfaces are from each other at most."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from softsim_core.arrays import Array
from softsim_core.mesh.types import SurfaceMesh

_PIECES = 4_000
"""About so many pieces a surface is cut into, or more where it has more triangles."""
_NEAREST = 12
_FAR = 20.0
"""Places farther than this many sizes of a piece may be told as farther, by one size at most."""
_CHUNK = 4096


def largest_distance(first: SurfaceMesh, second: SurfaceMesh) -> tuple[float, Array]:
    """How far the first surface gets from the second at most in [m], and where, (3,).

    Looked at in the corners of the first one's triangles, and in the middles of these, large ones cut into
    pieces.
    """
    pieces = cut(first.points[first.triangles], _piece(first))
    samples = np.concatenate([first.points[np.unique(first.triangles)], pieces.mean(axis=1)])
    far = distances(samples, second)
    worst = int(far.argmax())
    return float(far[worst]), samples[worst]


def distances(places: Array, surface: SurfaceMesh) -> Array:
    """Distances in [m] of places (p, 3) to a surface, shape (p,); exact near it, within 5 % far from it."""
    corners = cut(surface.points[surface.triangles], _piece(surface))
    middles = corners.mean(axis=1)
    reach = float(np.linalg.norm(corners - middles[:, None], axis=2).max())
    tree = cKDTree(middles)
    count = min(_NEAREST, len(corners))
    away, near = tree.query(places, k=count)
    away, near = away.reshape(len(places), count), near.reshape(len(places), count)
    result = _to_triangles(np.repeat(places, count, axis=0), corners[near.reshape(-1)])
    result = result.reshape(len(places), count).min(axis=1)
    unsure = (away[:, -1] < result + reach) & (result < _FAR * reach)
    unsure = np.flatnonzero(unsure & (count < len(corners)))
    for start in range(0, len(unsure), _CHUNK):
        some = unsure[start : start + _CHUNK]
        others = tree.query_ball_point(places[some], result[some] + reach)
        lengths = np.array([len(each) for each in others])
        numbers = np.concatenate([np.array(each, dtype=np.int64) for each in others])
        exact = _to_triangles(np.repeat(places[some], lengths, axis=0), corners[numbers])
        result[some] = np.minimum.reduceat(exact, np.cumsum(lengths) - lengths)
    return result


def cut(corners: Array, longest: float) -> Array:
    """Triangles (k, 3, 3) halved across their longest edge until none is longer, shape (p, 3, 3)."""
    done = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = lengths.max(axis=1) > longest
        done.append(corners[~long])
        corners, side = corners[long], lengths[long].argmax(axis=1)
        rows = np.arange(len(corners))
        a, b, c = (corners[rows, (side + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def _piece(surface: SurfaceMesh) -> float:
    """Longest edge of a piece, so that there are about _PIECES of them."""
    a, b, c = np.moveaxis(surface.points[surface.triangles], 1, 0)
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    size = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    return max(float(np.sqrt(4.0 * area / _PIECES)), 2.0e-3 * size)


def _to_triangles(places: Array, corners: Array) -> Array:
    """Distances of places (p, 3), each to its triangle (p, 3, 3), shape (p,)."""
    edges = np.roll(corners, -1, axis=1) - corners
    off = places[:, None] - corners
    square = np.maximum((edges * edges).sum(axis=2), 1e-300)
    share = np.clip((off * edges).sum(axis=2) / square, 0.0, 1.0)
    to_edges = np.linalg.norm(off - share[..., None] * edges, axis=2).min(axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=1)
    over = ((np.cross(edges, off) * normal[:, None]).sum(axis=2) >= 0.0).all(axis=1) & (length > 0.0)
    height = np.abs((off[:, 0] * normal).sum(axis=1)) / np.maximum(length, 1e-300)
    return np.asarray(np.where(over, height, to_edges))
