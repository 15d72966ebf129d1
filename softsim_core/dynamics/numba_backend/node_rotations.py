"""How the surroundings of each node have turned since a body was at rest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray, unique_pairs
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.rotation import nearest_rotation
from softsim_core.dynamics.numba_backend.scatter import node_pairs
from softsim_core.fem.group import ElementGroup
from softsim_core.mechanics.model import Model


class Surroundings(NamedTuple):
    """Free nodes and the nodes that share a cell with them.

    Attributes:
        node: Node index, in the order of unknowns, shape (f,).
        start: Where the neighbours of each begin; the last one ends them, shape (f + 1,).
        neighbour: Node indices.
        rest: From the node to each neighbour at rest, over its length squared, in [1/m], shape (., 3).
    """

    node: IndexArray
    start: IndexArray
    neighbour: IndexArray
    rest: Array


def surroundings(model: Model, groups: Iterable[ElementGroup], position: IndexArray) -> Surroundings:
    """Those of a model's free nodes; `position` (f,): their places in the order of unknowns."""
    place = np.full(len(model.rest), -1, dtype=np.int64)
    place[model.free_nodes] = position
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(node_pairs(group.cells) for group in groups)])
    pairs = unique_pairs(pairs[(place[pairs[:, 0]] >= 0) & (pairs[:, 0] != pairs[:, 1])])
    pairs = pairs[np.argsort(place[pairs[:, 0]], kind="stable")]
    counts = np.bincount(place[pairs[:, 0]], minlength=len(position))
    away = model.rest[pairs[:, 1]] - model.rest[pairs[:, 0]]
    return Surroundings(
        model.free_nodes[np.argsort(position)],
        np.concatenate([[0], np.cumsum(counts)]),
        np.ascontiguousarray(pairs[:, 1]),
        away / np.maximum((away * away).sum(axis=1), np.finfo(float).tiny)[:, None],
    )


@kernel
def turn(x: Array, around: Surroundings, rotations: Array) -> None:
    """Nearest rotation from the neighbours of each node at rest to those at x (n, 3), shape (f, 3, 3)."""
    f = np.empty((3, 3))
    for n in range(len(around.node)):
        node = around.node[n]
        f[:] = 0.0
        for e in range(around.start[n], around.start[n + 1]):
            other = around.neighbour[e]
            for i in range(3):
                along = x[other, i] - x[node, i]
                for j in range(3):
                    f[i, j] += along * around.rest[e, j]
        nearest_rotation(f, rotations[n])
