"""Broad phase: bounding boxes of moving surfaces, comparison of their trees, and lists of close leaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.detection.candidates import Near
from softsim_core.physics.contact.detection.geometry import cross, dot, minus, row, unit
from softsim_core.physics.contact.detection.topology import Topology


class Boxes(NamedTuple):
    """Axis-aligned boxes (lowest x, y, z, highest x, y, z) in [m], and normals; S, N, T, V as in Topology.

    Attributes:
        surface: Box of each surface, shape (S, 6).
        node: Box of each tree node, shape (N, 6).
        triangle: Box of each triangle, shape (T, 6).
        normal: Unit normal of each triangle, shape (T, 3).
        nearest: For the current pair, distance in [m] of each vertex from the nearest point of the other
            surface that has it outside, that has it inside, and that faces its own surface, shape (V, 3).
        latest: Last retained contact of each vertex of the current pair, or -1, shape (V,).
        stack: Pairs of nodes still to be compared, shape (depth, 2).
    """

    surface: Array
    node: Array
    triangle: Array
    normal: Array
    nearest: Array
    latest: IndexArray
    stack: IndexArray


def allocate(topology: Topology) -> Boxes:
    """Return buffers for the boxes of a topology."""
    surfaces, nodes, triangles = len(topology.closed), len(topology.node_first), len(topology.triangles)
    return Boxes(
        surface=np.zeros((surfaces, 6)),
        node=np.zeros((nodes, 6)),
        triangle=np.zeros((triangles, 6)),
        normal=np.zeros((triangles, 3)),
        nearest=np.full((len(topology.radius), 3), np.inf),
        latest=np.full(len(topology.radius), -1, dtype=np.int64),
        stack=np.zeros((4 * nodes + 16, 2), dtype=np.int64),
    )


@kernel
def apart(a: Array, i: int, b: Array, j: int, reach: float) -> bool:
    """Return whether boxes a[i] and b[j] are farther apart than `reach` along an axis."""
    for d in range(3):  # noqa: SIM110 - Numba compiles no generators
        if max(a[i, d] - b[j, 3 + d], b[j, d] - a[i, 3 + d]) > reach:
            return True
    return False


@kernel
def outside(points: Array, v: int, boxes: Array, i: int, reach: float) -> bool:
    """Return whether vertex v is farther than `reach` from box i along an axis."""
    for d in range(3):  # noqa: SIM110 - Numba compiles no generators
        if max(points[v, d] - boxes[i, 3 + d], boxes[i, d] - points[v, d]) > reach:
            return True
    return False


@kernel
def segments_apart(points: Array, i: int, j: int, k: int, m: int, reach: float) -> bool:
    """Return whether the boxes of segments i j and k m are farther apart than `reach` along an axis."""
    for d in range(3):
        a, b, c, e = points[i, d], points[j, d], points[k, d], points[m, d]
        if max(min(a, b) - max(c, e), min(c, e) - max(a, b)) > reach:
            return True
    return False


@kernel
def beyond(points: Array, triangles: IndexArray, t: int, normals: Array, u: int, reach: float) -> bool:
    """Return whether triangle t is on one side of the plane of u, farther away than `reach`."""
    normal, base = row(normals, u), row(points, triangles[u, 0])
    low = high = dot(minus(row(points, triangles[t, 0]), base), normal)
    for c in range(1, 3):
        height = dot(minus(row(points, triangles[t, c]), base), normal)
        low, high = min(low, height), max(high, height)
    return low > reach or high < -reach


@kernel
def surface_boxes(points: Array, topology: Topology, boxes: Boxes) -> None:
    """Compute the boxes of all surfaces from their vertices; that of a sphere contains the whole sphere."""
    for s in range(topology.surface_vertex.shape[0]):
        first, end = topology.surface_vertex[s, 0], topology.surface_vertex[s, 1]
        for d in range(3):
            low = high = points[first, d]
            for v in range(first + 1, end):
                low = min(low, points[v, d])
                high = max(high, points[v, d])
            boxes.surface[s, d] = low - topology.radius[first]
            boxes.surface[s, 3 + d] = high + topology.radius[first]


@kernel
def refit(s: int, points: Array, topology: Topology, boxes: Boxes) -> None:
    """Compute the boxes of the triangles and tree nodes of surface s, and its normals."""
    first, end = topology.surface_triangle[s]
    _refit_triangles(first, end, points, topology.triangles, boxes.triangle, boxes.normal)
    first, end = topology.surface_node[s]
    if topology.node_count[first] == 0:
        v = topology.node_first[first]
        for d in range(3):
            boxes.node[first, d] = points[v, d] - topology.radius[v]
            boxes.node[first, 3 + d] = points[v, d] + topology.radius[v]
    else:
        refit_nodes(first, end, topology, boxes)


@kernel
def _refit_triangles(
    first: int, end: int, points: Array, triangles: IndexArray, boxes: Array, normals: Array
) -> None:
    for t in range(first, end):
        a, b, c = row(points, triangles[t, 0]), row(points, triangles[t, 1]), row(points, triangles[t, 2])
        for d in range(3):
            boxes[t, d] = min(a[d], b[d], c[d])
            boxes[t, 3 + d] = max(a[d], b[d], c[d])
        normals[t, 0], normals[t, 1], normals[t, 2] = unit(cross(minus(b, a), minus(c, a)))


@kernel
def refit_nodes(first: int, end: int, topology: Topology, boxes: Boxes) -> None:
    """Compute the boxes of tree nodes first to end from those of their triangles."""
    for node in range(end - 1, first - 1, -1):  # children follow their parent in the arrays
        count = topology.node_count[node]
        if count < 0:
            _cover(boxes.node, topology.node_child[node], 2, boxes.node, node)
        else:
            _cover(boxes.triangle, topology.node_first[node], count, boxes.node, node)


@kernel
def _cover(boxes: Array, first: int, count: int, out: Array, k: int) -> None:
    """Set out[k] to the box around boxes[first : first + count]."""
    for d in range(3):
        low, high = boxes[first, d], boxes[first, 3 + d]
        for i in range(first + 1, first + count):
            low, high = min(low, boxes[i, d]), max(high, boxes[i, 3 + d])
        out[k, d], out[k, 3 + d] = low, high


@kernel
def compare_trees(
    root_a: int, root_b: int, reach: float, topology: Topology, boxes: Boxes, near: Near
) -> None:
    """Descend both trees together and list pairs of close leaves. Either tree may be a sphere."""
    stack, nodes, counts, child = boxes.stack, boxes.node, topology.node_count, topology.node_child
    near.counts[:] = 0
    stack[0, 0], stack[0, 1] = root_a, root_b
    size = 1
    while size > 0:
        size -= 1
        i, j = stack[size, 0], stack[size, 1]
        if apart(nodes, i, nodes, j, reach):
            continue
        if counts[i] < 0:
            stack[size, 0], stack[size, 1] = child[i] + 1, j
            stack[size + 1, 0], stack[size + 1, 1] = child[i], j
            size += 2
        elif counts[j] < 0:
            stack[size, 0], stack[size, 1] = i, child[j] + 1
            stack[size + 1, 0], stack[size + 1, 1] = i, child[j]
            size += 2
        elif counts[i] == 0 or counts[j] == 0:
            sphere, other = (i, j) if counts[i] == 0 else (j, i)
            for t in range(topology.node_first[other], topology.node_first[other] + counts[other]):
                list_vertex(topology.node_first[sphere], t, int(counts[j] == 0), near.vertices, near.counts)
        else:
            list_pair(i, j, 2, near.leaves, near.counts)


@kernel
def list_pair(a: int, b: int, kind: int, pairs: IndexArray, counts: IndexArray) -> None:
    """Append a and b to the list that counts[kind] belongs to; it is only counted where the list is full."""
    at = counts[kind]
    counts[kind] += 1
    if at < pairs.shape[0]:
        pairs[at, 0], pairs[at, 1] = a, b


@kernel
def list_vertex(v: int, t: int, second: int, vertices: IndexArray, counts: IndexArray) -> None:
    """Append vertex v and triangle t to the list; the pair is only counted where the list is full."""
    at = counts[0]
    counts[0] += 1
    if at < vertices.shape[0]:
        vertices[at, 0], vertices[at, 1], vertices[at, 2] = v, t, second
