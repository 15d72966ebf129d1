"""Arrays of cables: where the entries of their rows stand, and what the compiled kernels take."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.model import Model

IN_BODY, IN_WORLD = -2, -1
"""What carries a cable's point where no joint does."""


class RowLayout(NamedTuple):
    """Rows of c cables, a cable's points first, then the joints that carry its pull point.

    Attributes:
        start: Where the entries of each row begin; the last one ends them, shape (c + 1,).
        place: Node, or number of nodes + reduced coordinate, of each entry, shape (k,).
        of_points: Entries of the points, four each, shape (4 p,).
        levers: Entries of joints that carry pull points, shape (m,).
        lever_points: Pull point of each of them, shape (m,).
        lever_unknowns: Reduced coordinate of each of them, shape (m,).
    """

    start: IndexArray
    place: IndexArray
    of_points: IndexArray
    levers: IndexArray
    lever_points: IndexArray
    lever_unknowns: IndexArray


class CableArrays(NamedTuple):
    """All cables of a scene: p points, m joints that carry pull points.

    Attributes:
        first: Where each cable's points begin; the last one ends them, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and their weights, shapes (p, 4).
        carrier: Joint that carries each point, or IN_WORLD or IN_BODY, shape (p,).
        local: Where in the carrier's frame in [m], shape (p, 3).
        entry: First of the four entries of each point in the rows of all cables, shape (p,).
        levers, lever_points, lever_unknowns: See RowLayout, shapes (m,).
        rest_length: In [m], shape (c,).
        points, pulls: Filled by `measure_cables`: points in [m], and H on them, shape (p, 3).
    """

    first: IndexArray
    nodes: IndexArray
    weights: Array
    carrier: IndexArray
    local: Array
    entry: IndexArray
    levers: IndexArray
    lever_points: IndexArray
    lever_unknowns: IndexArray
    rest_length: Array
    points: Array
    pulls: Array


def row_layout(
    model: Model, first: IndexArray, nodes: IndexArray, pull: Sequence[tuple[int, int, Array]]
) -> RowLayout:
    """The layout of cables; for the arguments see Cables."""
    count, frames = len(model.rest), 6 * len(model.frame_names)
    start, levers = [0], []
    place: list[int] = []
    of_points: list[int] = []
    for own in itertools.starmap(range, itertools.pairwise(first.tolist())):
        of_points += range(len(place), len(place) + 4 * len(own))
        place += nodes[own.start : own.stop].ravel().tolist()
        for point, carrier, _ in pull:
            if point in own and carrier >= 0:
                for unknown in (frames + a for a in model.chain(carrier)):
                    levers.append((len(place), point, unknown))
                    place.append(count + unknown)
        start.append(len(place))
    table = np.array(levers, dtype=np.int64).reshape(-1, 3)
    return RowLayout(
        np.array(start),
        np.array(place, dtype=np.int64),
        np.array(of_points, dtype=np.int64),
        *(column.copy() for column in table.T),
    )
