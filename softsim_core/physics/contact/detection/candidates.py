"""Output buffers of the contact kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.detection.geometry import Vector
from softsim_core.physics.contact.detection.topology import Topology


class ContactBuffers(NamedTuple):
    """Buffers for contacts; the first `counter[0]` rows are valid. Fields have the meaning of Proximities.

    Attributes:
        a, a_weights, b, b_weights, normal, distance, pair, key: As in Proximities, with `size` rows.
        foremost: As in Proximities, shape (size,).
        depth: Depth in [m] of the vertex (a sphere's centre) inside the other surface; 0 outside, shape
            (size,).
        seeker: Vertex that found the contact, -1 for two edges or two spheres, shape (size,).
        earlier: Contact found before by the same seeker, or -1, shape (size,).
        counter: Number of contacts found, including those that did not fit, shape (1,).
    """

    a: IndexArray
    a_weights: Array
    b: IndexArray
    b_weights: Array
    normal: Array
    distance: Array
    pair: IndexArray
    key: IndexArray
    foremost: BoolArray
    depth: Array
    seeker: IndexArray
    earlier: IndexArray
    counter: IndexArray


def allocate_found(size: int) -> ContactBuffers:
    """Return buffers for `size` contacts."""
    return ContactBuffers(
        a=np.zeros((size, 3), dtype=np.int64),
        a_weights=np.zeros((size, 3)),
        b=np.zeros((size, 3), dtype=np.int64),
        b_weights=np.zeros((size, 3)),
        normal=np.zeros((size, 3)),
        distance=np.zeros(size),
        pair=np.zeros((size, 2), dtype=np.int64),
        key=np.zeros(size, dtype=np.int64),
        foremost=np.zeros(size, dtype=np.bool_),
        depth=np.zeros(size),
        seeker=np.zeros(size, dtype=np.int64),
        earlier=np.zeros(size, dtype=np.int64),
        counter=np.zeros(1, dtype=np.int64),
    )


class Near(NamedTuple):
    """Pairs of leaves and of features of two surfaces that are close enough for the narrow phase.

    Attributes:
        vertices: Vertex, triangle, and 1 where the vertex is of the second surface, shape (size, 3).
        edges: Edge of the first surface, edge of the second, shape (size, 2).
        leaves: Leaf of the first tree, leaf of the second, shape (size, 2).
        counts: Number of rows of `vertices`, `edges` and `leaves`, including rows that did not fit, shape
            (3,).
    """

    vertices: IndexArray
    edges: IndexArray
    leaves: IndexArray
    counts: IndexArray


def allocate_near(size: int) -> Near:
    """Return buffers for `size` pairs of each kind."""
    return Near(
        vertices=np.zeros((size, 3), dtype=np.int64),
        edges=np.zeros((size, 2), dtype=np.int64),
        leaves=np.zeros((size, 2), dtype=np.int64),
        counts=np.zeros(3, dtype=np.int64),
    )


@kernel
def next_row(counter: IndexArray, buffer: Array) -> int:
    """Return the row for one more contact, or -1 where the buffer is full; count it in either case."""
    at = counter[0]
    counter[0] += 1
    return int(at) if at < buffer.shape[0] else -1


@kernel
def interpolate_side(nodes: IndexArray, weights: Array, k: int, points: Array) -> Vector:
    """Return the point of one side of contact k: the weighted sum of its three vertices."""
    h, i, j = nodes[k, 0], nodes[k, 1], nodes[k, 2]
    u, v, w = weights[k, 0], weights[k, 1], weights[k, 2]
    return (
        u * points[h, 0] + v * points[i, 0] + w * points[j, 0],
        u * points[h, 1] + v * points[i, 1] + w * points[j, 1],
        u * points[h, 2] + v * points[i, 2] + w * points[j, 2],
    )


@kernel
def move(source: int, target: int, found: ContactBuffers) -> None:
    """Copy contact `source` over contact `target`."""
    for d in range(3):
        found.a[target, d] = found.a[source, d]
        found.b[target, d] = found.b[source, d]
        found.a_weights[target, d] = found.a_weights[source, d]
        found.b_weights[target, d] = found.b_weights[source, d]
        found.normal[target, d] = found.normal[source, d]
    found.pair[target, 0], found.pair[target, 1] = found.pair[source, 0], found.pair[source, 1]
    found.distance[target] = found.distance[source]
    found.key[target] = found.key[source]
    found.depth[target] = found.depth[source]
    found.seeker[target] = found.seeker[source]
    found.foremost[target] = found.foremost[source]


@kernel
def features(topology: Topology) -> int:
    """Return the number of vertices, edges and triangles; a pair has the key first * features + second."""
    return int(topology.radius.shape[0] + topology.edges.shape[0] + topology.triangles.shape[0])


@kernel
def write(nodes: IndexArray, weights: Array, at: int, ids: tuple[int, int, int], shares: Vector) -> None:
    """Set the vertices and weights of one side of contact `at`."""
    nodes[at, 0], nodes[at, 1], nodes[at, 2] = ids
    weights[at, 0], weights[at, 1], weights[at, 2] = shares


@kernel
def write_pair(normals: Array, pairs: IndexArray, at: int, normal: Vector, sa: int, sb: int) -> None:
    """Set the normal and the surfaces of contact `at`."""
    normals[at, 0], normals[at, 1], normals[at, 2] = normal
    pairs[at, 0], pairs[at, 1] = sa, sb
