"""Connectivity of triangles, and distances between two surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.mesh import SurfaceMesh, triangle_normals


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The edges of triangles.

    Attributes:
        ends: Vertices of each edge, the smaller number first, shape (e, 2).
        of: Edge along each side 0-1, 1-2, 2-0 of each triangle, shape (k, 3).
        along: Whether that side runs from the smaller number to the larger, shape (k, 3).
        uses: Number of triangles of each edge, shape (e,).
    """

    ends: IndexArray
    of: IndexArray
    along: BoolArray
    uses: IndexArray

    @property
    def odd(self) -> BoolArray:
        """Whether each edge has an odd number of triangles, shape (e,); a closed surface has no such edge."""
        return np.asarray(self.uses % 2 == 1)

    @property
    def unbalanced(self) -> BoolArray:
        """Whether the triangles of each edge do not run equally often in both directions, shape (e,)."""
        turns = np.bincount(
            self.of.reshape(-1), np.where(self.along, 1.0, -1.0).reshape(-1), minlength=len(self.ends)
        )
        return np.asarray(turns != 0.0)


def edges_of(triangles: IndexArray) -> Edges:
    """Return the edges of triangles (k, 3)."""
    start, end = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    span = int(triangles.max(initial=0)) + 1
    keys, of, uses = np.unique(low * span + high, return_inverse=True, return_counts=True)
    ends = np.stack(np.divmod(keys, span), axis=1)
    return Edges(ends, of.reshape(-1, 3), (start < end).reshape(-1, 3), uses)


def connected(size: int, first: IndexArray, second: IndexArray) -> tuple[int, IndexArray]:
    """Return the number of groups that pairs of numbers below `size` form, and each number's group."""
    graph = sp.coo_matrix((np.ones(len(first)), (first, second)), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    return int(count), label.astype(np.int64)


def shells(triangles: IndexArray) -> tuple[int, IndexArray]:
    """Return the number of pieces that edges of two triangles connect, and each triangle's piece (k,)."""
    first, second, _ = _neighbours(edges_of(triangles))
    return connected(len(triangles), first, second)


def turned_alike(triangles: IndexArray) -> tuple[IndexArray, int, IndexArray]:
    """Orient the triangles of each shell consistently, in the direction of most of them.

    Returns:
        The triangles, shape (k, 3), the number of reversed ones, and the ends of the edges, shape (b, 2), at
        which consistency is impossible: a surface with one side only.
    """
    k, edges = len(triangles), edges_of(triangles)
    first, second, alike = _neighbours(edges)
    count, label = connected(k, first, second)
    # a tree over all triangles, joined at one extra node by a triangle of each shell; -1: oriented otherwise
    rows = np.concatenate([first, np.full(count, k)])
    columns = np.concatenate([second, np.unique(label, return_index=True)[1]])
    values = np.concatenate([np.where(alike, 1, -1), np.ones(count, dtype=np.int64)])
    graph = sp.coo_matrix((values, (rows, columns)), shape=(k + 1, k + 1)).tocsr()
    _, parent = breadth_first_order(graph, k, directed=False)
    parent = np.append(parent[:k].astype(np.int64), k)
    sign = np.where(np.asarray((graph + graph.T)[np.arange(k + 1), parent]).ravel() < 0, -1, 1)
    while (parent != k).any():  # pointer doubling
        sign, parent = sign * sign[parent], parent[parent]
    sign = sign[:k]
    most = np.bincount(label, sign, minlength=count) < 0.0
    turn = (sign < 0) != most[label]
    result = triangles.copy()
    result[turn] = result[turn][:, ::-1]
    wrong = sign[first] * sign[second] != np.where(alike, 1, -1)
    sides = np.flatnonzero(edges.uses == 2)[wrong]
    return result, int(turn.sum()), edges.ends[sides]


def _neighbours(edges: Edges) -> tuple[IndexArray, IndexArray, BoolArray]:
    """Return both triangles of each edge with two, and whether they are oriented alike."""
    order = np.argsort(edges.of.reshape(-1), kind="stable")
    begin = np.concatenate([[0], np.cumsum(edges.uses)])[:-1]
    begin = begin[edges.uses == 2]
    one, other = order[begin], order[begin + 1]
    along = edges.along.reshape(-1)
    return one // 3, other // 3, np.asarray(along[one] != along[other])


def touching_points(triangles: IndexArray) -> IndexArray:
    """Return vertices at which pieces of surface meet only in a point, with several fans of triangles."""
    edges = edges_of(triangles)
    order = np.argsort(edges.of.reshape(-1), kind="stable")
    same = edges.of.reshape(-1)[order]
    # corners (triangle, vertex) at one vertex are connected across the edges that lead to it
    corner = np.arange(triangles.size).reshape(-1, 3)
    begin, following = corner.reshape(-1), np.roll(corner, -1, axis=1).reshape(-1)
    pairs = np.flatnonzero((same[1:] == same[:-1]) & (edges.uses[same[1:]] == 2))
    a, b = order[pairs], order[pairs + 1]
    crossed = edges.along.reshape(-1)[a] != edges.along.reshape(-1)[b]
    rows = np.concatenate([begin[a], following[a]])
    columns = np.concatenate(
        [np.where(crossed, following[b], begin[b]), np.where(crossed, begin[b], following[b])]
    )
    _, fan = connected(triangles.size, rows, columns)
    _, one = np.unique(fan, return_index=True)
    vertices, fans = np.unique(triangles.reshape(-1)[one], return_counts=True)
    return np.asarray(vertices[fans > 1], dtype=np.int64)


def areas(points: Array, triangles: IndexArray) -> Array:
    """Return the areas of triangles, shape (k,)."""
    return np.asarray(np.linalg.norm(triangle_normals(points, triangles), axis=1))


_PIECES = 4_000  # approximate number of pieces of a subdivided surface, or more if it has more triangles
_NEAREST = 12
_FAR = 20.0  # distances of more than this many piece sizes may be overestimated by one size at most
_CHUNK = 4096


def largest_distance(first: SurfaceMesh, second: SurfaceMesh) -> tuple[float, Array]:
    """Return the largest distance of the first surface from the second in [m], and its place, (3,).

    It is evaluated at the corners of the first one's triangles and at their centres; large triangles are
    subdivided.
    """
    pieces = cut(first.points[first.triangles], _piece(first))
    samples = np.concatenate([first.points[np.unique(first.triangles)], pieces.mean(axis=1)])
    far = distances(samples, second)
    worst = int(far.argmax())
    return float(far[worst]), samples[worst]


def distances(places: Array, surface: SurfaceMesh) -> Array:
    """Return distances (p,) in [m] of places (p, 3) to a surface; exact near it, within 5 % far away."""
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
    """Halve triangles (k, 3, 3) across their longest edge until no edge exceeds `longest`, (p, 3, 3)."""
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
    """Return the longest edge of a piece at which a surface has about _PIECES pieces."""
    area = float(areas(surface.points, surface.triangles).sum())
    size = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    return max(float(np.sqrt(4.0 * area / _PIECES)), 2.0e-3 * size)


def _to_triangles(places: Array, corners: Array) -> Array:
    """Return distances of places (p, 3), each to its triangle (p, 3, 3), shape (p,)."""
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
