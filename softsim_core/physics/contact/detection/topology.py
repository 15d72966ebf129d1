"""Topology of collision surfaces: neighbours, trees, and the triangle that owns each feature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.contact import CollisionSurface, may_meet

_LEAF = 4
"""Largest number of triangles in a leaf of a tree."""


class Topology(NamedTuple):
    """All surfaces together: S surfaces, V vertices, E edges, T triangles, N tree nodes, L neighbours.

    Triangles are sorted so that each tree node has a contiguous range of them. A feature (vertex, edge) is
    owned by one of its triangles only, so no pair of features is tested twice.

    Attributes:
        triangles: Vertices of each triangle, shape (T, 3).
        triangle_edges: Edges of each triangle: corner 0 to 1, 1 to 2, 2 to 0, shape (T, 3).
        owns: Whether a triangle owns its corners (0..2) and edges (3..5), shape (T, 6).
        edges: Vertices of each edge, shape (E, 2).
        opposite: Third vertices of the edge's triangles, or -1, shape (E, 2).
        sides: Triangles of the edge, or -1, shape (E, 2).
        ring_start: First neighbour of each vertex in `ring`, shape (V + 1,).
        ring: Neighbour vertices, shape (L,).
        fan_start: First triangle of each vertex in `fan`, shape (V + 1,).
        fan: Triangles around the vertices, shape (3 T,).
        radius: Radius of spheres in [m], else 0, shape (V,).
        node_first: First triangle of each node; the vertex if the node is a sphere, shape (N,).
        node_count: Number of triangles of a leaf; 0: sphere; -1: inner node, shape (N,).
        node_child: First of the two children, which are consecutive and follow their parent, shape (N,).
        surface_node: First node (the root) of each surface and the end, shape (S, 2).
        surface_triangle: Range of triangles of each surface, shape (S, 2).
        surface_vertex: Range of vertices of each surface, shape (S, 2).
        soft: 1 where the surface deforms, shape (S,).
        closed: 1 where the surface encloses a volume, shape (S,).
        pairs: Surfaces that may meet, shape (p, 2).
        same_owner: 1 where the two belong to one body, shape (p,).
    """

    triangles: IndexArray
    triangle_edges: IndexArray
    owns: IndexArray
    edges: IndexArray
    opposite: IndexArray
    sides: IndexArray
    ring_start: IndexArray
    ring: IndexArray
    fan_start: IndexArray
    fan: IndexArray
    radius: Array
    node_first: IndexArray
    node_count: IndexArray
    node_child: IndexArray
    surface_node: IndexArray
    surface_triangle: IndexArray
    surface_vertex: IndexArray
    soft: IndexArray
    closed: IndexArray
    pairs: IndexArray
    same_owner: IndexArray


def build_topology(surfaces: tuple[CollisionSurface, ...], rest_points: Array) -> Topology:
    """Return the neighbours and trees of surfaces; the trees are built on the rest shape.

    Args:
        surfaces: Surfaces over disjoint ranges of the vertices.
        rest_points: Vertex positions at rest in [m], shape (V, 3).
    """
    trees = _Trees()
    for surface in surfaces:
        trees.add(surface, rest_points)
    triangles = np.concatenate([np.empty((0, 3), dtype=np.int64), *trees.triangles])
    n = len(rest_points)

    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, edge_of = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1).astype(np.int64)
    sides = np.full((len(edges), 2), -1, dtype=np.int64)
    opposite = np.full((len(edges), 2), -1, dtype=np.int64)
    owns = np.zeros((len(triangles), 6), dtype=np.int64)
    for slot, edge in enumerate(edge_of):
        triangle, corner = divmod(slot, 3)
        side = 0 if sides[edge, 0] < 0 else 1
        sides[edge, side] = triangle
        opposite[edge, side] = triangles[triangle, (corner + 2) % 3]
        owns[triangle, 3 + corner] = side == 0
    _, first = np.unique(triangles.reshape(-1), return_index=True)
    owns[first // 3, first % 3] = 1

    both_ways = np.concatenate([edges, edges[:, ::-1]]) if len(edges) else np.empty((0, 2), dtype=np.int64)
    ring_start, ring = _group_by_key(both_ways[:, 0], both_ways[:, 1], n)
    fan_start, fan = _group_by_key(triangles.reshape(-1), np.repeat(np.arange(len(triangles)), 3), n)
    radius = np.zeros(n)
    for surface in surfaces:
        radius[surface.vertices] = surface.radius
    pairs = [
        (i, j)
        for i, a in enumerate(surfaces)
        for j, b in enumerate(surfaces[i + 1 :], i + 1)
        if may_meet(a, b)
    ]
    return Topology(
        triangles=triangles,
        triangle_edges=edge_of.reshape(-1, 3),
        owns=owns,
        edges=edges.reshape(-1, 2),
        opposite=opposite,
        sides=sides,
        ring_start=ring_start,
        ring=ring,
        fan_start=fan_start,
        fan=fan,
        radius=radius,
        node_first=np.array(trees.first, dtype=np.int64),
        node_count=np.array(trees.count, dtype=np.int64),
        node_child=np.array(trees.child, dtype=np.int64),
        surface_node=_ranges(trees.node_ends),
        surface_triangle=_ranges(trees.triangle_ends),
        surface_vertex=np.array([each.vertices.indices(n)[:2] for each in surfaces], dtype=np.int64).reshape(
            -1, 2
        ),
        soft=np.array([each.soft for each in surfaces], dtype=np.int64),
        closed=np.array([each.closed for each in surfaces], dtype=np.int64),
        pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        same_owner=np.array([surfaces[i].owner == surfaces[j].owner for i, j in pairs], dtype=np.int64),
    )


class _Trees:
    """Binary trees of all surfaces in sequence, split in halves along the longest axis of the centres."""

    def __init__(self) -> None:
        self.first: list[int] = []
        self.count: list[int] = []
        self.child: list[int] = []
        self.node_ends = [0]
        self.triangle_ends = [0]
        self.triangles: list[IndexArray] = []

    def add(self, surface: CollisionSurface, points: Array) -> None:
        """Append the tree of a surface, and its triangles in the order of the leaves."""
        start = self.triangle_ends[-1]
        if surface.radius > 0.0:
            self._node(surface.vertices.indices(len(points))[0], 0)
        else:
            order = np.arange(len(surface.triangles))
            centres = points[surface.triangles].mean(axis=1)
            root = self._node(start, len(order))
            self._split(root, order, centres, 0, start)
            self.triangles.append(np.asarray(surface.triangles[order], dtype=np.int64))
        self.node_ends.append(len(self.first))
        self.triangle_ends.append(start + len(surface.triangles))

    def _node(self, first: int, count: int) -> int:
        self.first.append(first)
        self.count.append(count)
        self.child.append(-1)
        return len(self.first) - 1

    def _split(self, node: int, order: IndexArray, centres: Array, offset: int, start: int) -> None:
        """Split a node over order[offset : offset + count] into two, reordering that part of `order`."""
        count = self.count[node]
        if count <= _LEAF:
            return
        part = order[offset : offset + count]
        spread = np.ptp(centres[part], axis=0)
        order[offset : offset + count] = part[np.argsort(centres[part, np.argmax(spread)], kind="stable")]
        half = count // 2
        left = self._node(start + offset, half)
        right = self._node(start + offset + half, count - half)
        self.child[node], self.count[node] = left, -1
        self._split(left, order, centres, offset, start)
        self._split(right, order, centres, offset + half, start)


def _group_by_key(keys: IndexArray, values: IndexArray, size: int) -> tuple[IndexArray, IndexArray]:
    """Return values sorted by key (stable), and the start of each key's part, shape (size + 1,)."""
    order = np.argsort(keys, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(keys, minlength=size))])
    return start.astype(np.int64), np.ascontiguousarray(values[order], dtype=np.int64)


def _ranges(ends: list[int]) -> IndexArray:
    """Return start and end of consecutive parts, shape (len(ends) - 1, 2)."""
    return np.column_stack([ends[:-1], ends[1:]]).astype(np.int64)
