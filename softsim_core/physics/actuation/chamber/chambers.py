"""All chambers of a scene, for plain and for compiled steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.actuation import ActuatorKind, Placed, PlainGroup, Surroundings
from softsim_core.physics.actuation.chamber.chamber import Chamber
from softsim_core.physics.actuation.chamber.description import ChamberDescription

_MOST = 6
"""Largest number of nodes of a face."""


class ChamberArrays(NamedTuple):
    """All chambers of a scene for the compiled kernels: f faces of up to six nodes.

    Attributes:
        row: Row of each chamber among those of all actuators, shape (c,).
        first: First face of each chamber, and the end of the last chamber, shape (c + 1,).
        size: Number of nodes per face of each chamber, shape (c,).
        nodes: Nodes of each face, shape (f, 6).
        entry: Entry of each of these nodes among those of all chambers, shape (f, 6).
        pairs: Pairs of a face's nodes, shape (c, 15, 2).
        shares: Factor of each pair's cross product in the slope of each node, shape (c, 15, 6).
        middle: Origin of each chamber in [m], shape (c, 3).
        at_rest: Volumes about the origin at rest in [m^3], shape (c,).
        begin: First entry of the chambers among those of all actuators, shape (1,).
        rows: Filled by `measure_chambers`: coefficients of their entries, shape (k, 3).
        corners, slopes: Buffers for one face, shapes (6, 3).
    """

    row: IndexArray
    first: IndexArray
    size: IndexArray
    nodes: IndexArray
    entry: IndexArray
    pairs: IndexArray
    shares: Array
    middle: Array
    at_rest: Array
    begin: IndexArray
    rows: Array
    corners: Array
    slopes: Array


class Chambers(PlainGroup):
    """All chambers of a scene as one actuator group, with arrays for the compiled kernels.

    Args:
        chambers: The chambers.
    """

    def __init__(self, chambers: Sequence[Chamber]) -> None:
        super().__init__(chambers)
        self._chambers = tuple(chambers)

    def to_arrays(self, row: int, entry: int) -> ChamberArrays:
        """Return the chambers for the compiled kernels; their first row and entry are `row` and `entry`."""
        start, count = self.constraints.start, len(self._chambers)
        first = np.cumsum([0, *(len(each.faces) for each in self._chambers)], dtype=np.int64)
        most = _MOST * (_MOST - 1) // 2
        pairs, shares = np.zeros((count, most, 2), np.int64), np.zeros((count, most, _MOST))
        nodes, entries = np.zeros((2, int(first[-1]), _MOST), np.int64)
        for c, each in enumerate(self._chambers):
            faces, size = slice(first[c], first[c + 1]), each.faces.shape[1]
            pairs[c, : len(each.pairs[0])] = np.stack(each.pairs, axis=1)
            shares[c, : len(each.pairs[0]), :size] = each.shares.T
            nodes[faces, :size] = each.place[each.faces]
            entries[faces, :size] = start[c] + each.faces
        return ChamberArrays(
            row=row + np.arange(count),
            first=first,
            size=np.array([each.faces.shape[1] for each in self._chambers], dtype=np.int64),
            nodes=nodes,
            entry=entries,
            pairs=pairs,
            shares=shares,
            middle=np.array([each.middle for each in self._chambers]).reshape(-1, 3),
            at_rest=np.array([each.at_rest for each in self._chambers]),
            begin=np.array([entry]),
            rows=np.zeros((int(start[-1]), 3)),
            corners=np.zeros((_MOST, 3)),
            slopes=np.zeros((_MOST, 3)),
        )


def _build_chambers(placed: Sequence[Placed], surroundings: Surroundings) -> Chambers:
    return Chambers([Chamber(each, surroundings) for each in placed])


CHAMBER: Final[ActuatorKind] = ActuatorKind(ChamberDescription.kind, ChamberDescription, _build_chambers)
