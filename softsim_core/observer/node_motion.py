"""How every node moves with the unknowns: computed a few nodes per step, so that a step costs the same."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows
from softsim_core.simulation import Simulation

NODES = 16
"""Free nodes whose motion is computed anew in one step."""


class NodeMotion:
    """Derivatives of the free nodes by p unknowns, at most as old as it takes to go through all of them.

    Args:
        model: The model.
        unknowns: p.
    """

    def __init__(self, model: Model, unknowns: int) -> None:
        self._model = model
        self._free = model.free_nodes
        self._next = 0
        self.by_unknowns = np.zeros((len(self._free), 3, unknowns))
        """Derivatives in [m] a unit of each unknown, in the order of Model.free_nodes, shape (k, 3, p)."""

    @property
    def parts(self) -> int:
        """Steps that it takes to go through all nodes."""
        return -(-len(self._free) // NODES)

    def rows(self) -> Rows:
        """The rows whose derivatives `take` wants next."""
        nodes = self._free[self._next : self._next + NODES]
        place = np.repeat(nodes, 3)
        return Rows(np.arange(len(place) + 1), place, np.tile(np.eye(3), (len(nodes), 1)))

    def take(self, derivatives: Array) -> None:
        """The derivatives (r, p) of the rows; the next `rows` are those of the next nodes."""
        count = len(derivatives) // 3
        self.by_unknowns[self._next : self._next + count] = derivatives.reshape(count, 3, -1)
        self._next = 0 if self._next + count >= len(self._free) else self._next + count

    def of_all(self, simulation: Simulation, reduced: Array) -> Array:
        """Derivatives of all nodes (n, 3, p), from those of frames and joints (b, p)."""
        result = np.zeros((len(self._model.rest), 3, reduced.shape[1]))
        result[self._free] = self.by_unknowns
        for nodes, moved in simulation.region_motion():
            result[nodes] = moved @ reduced
        return result
