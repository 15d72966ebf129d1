"""Moving boxes and normals: what is refreshed from the vertex positions before surfaces are compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.compile import kernel
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import cross, minus, row, unit


class Boxes(NamedTuple):
    """Axis-aligned boxes (lowest x, y, z, highest x, y, z) in [m], and normals; S, N, T, V as in Topology.

    Attributes:
        surface: Box of each surface, shape (S, 6).
        node: Box of each tree node, shape (N, 6).
        triangle: Box of each triangle, shape (T, 6).
        normal: Unit normal of each triangle, shape (T, 3).
        nearest: Nearest opposed point of the other surface to each vertex, of the pair at hand, shape (V,).
        stack: Pairs of nodes still to be compared, shape (depth, 2).
    """

    surface: Array
    node: Array
    triangle: Array
    normal: Array
    nearest: Array
    stack: IndexArray


def allocate(topology: Topology) -> Boxes:
    """Room for the boxes of a topology."""
    surfaces, nodes, triangles = len(topology.closed), len(topology.node_first), len(topology.triangles)
    return Boxes(
        surface=np.zeros((surfaces, 6)),
        node=np.zeros((nodes, 6)),
        triangle=np.zeros((triangles, 6)),
        normal=np.zeros((triangles, 3)),
        nearest=np.full(len(topology.radius), np.inf),
        stack=np.zeros((4 * nodes + 16, 2), dtype=np.int64),
    )


@kernel
def apart(a: Array, i: int, b: Array, j: int, reach: float) -> bool:
    """Whether boxes a[i] and b[j] are farther apart than `reach` along an axis."""
    for d in range(3):  # noqa: SIM110 - Numba compiles no generators
        if max(a[i, d] - b[j, 3 + d], b[j, d] - a[i, 3 + d]) > reach:
            return True
    return False


@kernel
def surface_boxes(points: Array, topology: Topology, boxes: Boxes) -> None:
    """Boxes of all surfaces, from their vertices; a sphere's box holds the whole sphere."""
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
    """Boxes of the triangles and tree nodes of surface s, and its normals."""
    for t in range(topology.surface_triangle[s, 0], topology.surface_triangle[s, 1]):
        i, j, k = topology.triangles[t, 0], topology.triangles[t, 1], topology.triangles[t, 2]
        for d in range(3):
            x, y, z = points[i, d], points[j, d], points[k, d]
            boxes.triangle[t, d] = min(x, y, z)
            boxes.triangle[t, 3 + d] = max(x, y, z)
        a = row(points, i)
        n = unit(cross(minus(row(points, j), a), minus(row(points, k), a)))
        boxes.normal[t, 0], boxes.normal[t, 1], boxes.normal[t, 2] = n
    root = topology.surface_node[s, 0]
    for back in range(topology.surface_node[s, 1] - root):
        node = topology.surface_node[s, 1] - 1 - back  # children stand behind their parent
        count, first = topology.node_count[node], topology.node_first[node]
        if count == 0:
            for d in range(3):
                boxes.node[node, d] = points[first, d] - topology.radius[first]
                boxes.node[node, 3 + d] = points[first, d] + topology.radius[first]
        elif count < 0:
            child = topology.node_child[node]
            _cover(boxes.node, child, child + 1, boxes.node, node)
        else:
            _cover(boxes.triangle, first, first + count - 1, boxes.node, node)
            for t in range(first + 1, first + count - 1):
                for d in range(3):
                    boxes.node[node, d] = min(boxes.node[node, d], boxes.triangle[t, d])
                    boxes.node[node, 3 + d] = max(boxes.node[node, 3 + d], boxes.triangle[t, 3 + d])


@kernel
def _cover(boxes: Array, i: int, j: int, out: Array, k: int) -> None:
    """out[k] becomes the box around boxes i and j."""
    for d in range(3):
        out[k, d] = min(boxes[i, d], boxes[j, d])
        out[k, 3 + d] = max(boxes[i, 3 + d], boxes[j, 3 + d])
