"""What the cells of a relaxing law remember and hold, with the kernels of their law; see fem.prony."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.batches import cell_batches
from softsim_core.dynamics.numba_backend.laws import compiled_law, point_cells, tune
from softsim_core.dynamics.numba_backend.point_cells import Given
from softsim_core.dynamics.numba_backend.relaxation import Memory, hold
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.prony import fading
from softsim_core.kernels import OneSignature


class RelaxingCells:
    """The cells of a group of a relaxing law that is compiled.

    Args:
        group: The cells, at least one.
    """

    def __init__(self, group: ElementGroup) -> None:
        law = compiled_law(group.material)
        assert law is not None
        self._group = group
        self._cells = point_cells(group, cell_batches(group), np.arange(len(group.cells)))
        self._hold, self._remember = OneSignature(hold), OneSignature(law.remember)
        self._tuned = np.zeros(0)

    def hold(self, p: Array, memory: Array, held: Array, h: float) -> None:
        """Put what is held in a step of h [s]; see fem.prony.held_stress."""
        self._hold(self._memory(p, memory, h), held)

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """See fem.prony.remember."""
        if not np.array_equal(p, self._tuned):
            tune(self._cells, self._group, p, shear_alone=True)
            self._tuned = p
        nothing = positions[:0]
        still = np.zeros_like(positions)
        given = Given(positions, nothing, still, np.zeros((0, 1, 3, 3)), False, 0.0, 1.0, 1.0)
        self._remember(given, self._cells, self._memory(p, memory, h))

    def _memory(self, p: Array, memory: Array, h: float) -> Memory:
        shares, fades, halves = fading(self._group, p, h)
        return Memory(memory, fades, shares * halves)
