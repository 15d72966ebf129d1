"""Where the contact kernels write what they find."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.compile import kernel
from softsim_core.contact.topology import Topology
from softsim_core.contact.vectors import Vector


class Found(NamedTuple):
    """Room for contacts; of the first `counter[0]` rows all is set. Meanings as in Proximities.

    Attributes:
        a, a_weights, b, b_weights, normal, distance, pair, key: As in Proximities, with `size` rows.
        depth: How far point P's centre line lies inside side b in [m]; 0 outside, shape (size,).
        seeker: The vertex that found a contact inside, or -1, shape (size,).
        counter: Number of contacts found, also when they no longer fit, shape (1,).
    """

    a: IndexArray
    a_weights: Array
    b: IndexArray
    b_weights: Array
    normal: Array
    distance: Array
    pair: IndexArray
    key: IndexArray
    depth: Array
    seeker: IndexArray
    counter: IndexArray


def allocate_found(size: int) -> Found:
    """Room for `size` contacts."""
    return Found(
        a=np.zeros((size, 3), dtype=np.int64),
        a_weights=np.zeros((size, 3)),
        b=np.zeros((size, 3), dtype=np.int64),
        b_weights=np.zeros((size, 3)),
        normal=np.zeros((size, 3)),
        distance=np.zeros(size),
        pair=np.zeros((size, 2), dtype=np.int64),
        key=np.zeros(size, dtype=np.int64),
        depth=np.zeros(size),
        seeker=np.zeros(size, dtype=np.int64),
        counter=np.zeros(1, dtype=np.int64),
    )


@kernel
def next_row(found: Found) -> int:
    """The row for one more contact, or -1 where there is no room; counted either way."""
    at = found.counter[0]
    found.counter[0] += 1
    return int(at) if at < found.distance.shape[0] else -1


@kernel
def mixed(nodes: IndexArray, weights: Array, k: int, points: Array) -> Vector:
    """The point of one side of contact k: its three vertices, weighted."""
    h, i, j = nodes[k, 0], nodes[k, 1], nodes[k, 2]
    u, v, w = weights[k, 0], weights[k, 1], weights[k, 2]
    return (
        u * points[h, 0] + v * points[i, 0] + w * points[j, 0],
        u * points[h, 1] + v * points[i, 1] + w * points[j, 1],
        u * points[h, 2] + v * points[i, 2] + w * points[j, 2],
    )


@kernel
def move(source: int, target: int, found: Found) -> None:
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


@kernel
def key_of(a: int, b: int, topology: Topology) -> int:
    """One number for a pair of features."""
    features = topology.radius.shape[0] + topology.edges.shape[0] + topology.triangles.shape[0]
    return int(a * features + b)


@kernel
def write(nodes: IndexArray, weights: Array, at: int, ids: tuple[int, int, int], shares: Vector) -> None:
    """Set one side of contact `at`."""
    nodes[at, 0], nodes[at, 1], nodes[at, 2] = ids
    weights[at, 0], weights[at, 1], weights[at, 2] = shares


@kernel
def write_vertex(nodes: IndexArray, weights: Array, at: int, v: int) -> None:
    """Set one side of contact `at` to a vertex."""
    write(nodes, weights, at, (v, v, v), (1.0, 0.0, 0.0))


@kernel
def write_pair(found: Found, at: int, sa: int, sb: int, normal: Vector, key: int) -> None:
    """Set what both sides of contact `at` have in common."""
    found.normal[at, 0], found.normal[at, 1], found.normal[at, 2] = normal
    found.pair[at, 0], found.pair[at, 1] = sa, sb
    found.key[at] = key
