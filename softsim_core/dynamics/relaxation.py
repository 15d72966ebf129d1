"""What a group of a relaxing law holds and remembers in a step, compiled where the step is."""

from __future__ import annotations

from typing import Protocol

from softsim_core.arrays import Array
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.prony import held_stress, remember


class Relaxation(Protocol):
    """See fem.prony."""

    def hold(self, p: Array, memory: Array, held: Array, h: float) -> None:
        """Put into `held` what is held in a step of h [s]; see fem.prony.held_stress."""
        ...

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """See fem.prony.remember."""
        ...


class PlainRelaxation:
    """In NumPy, of any law."""

    def __init__(self, group: ElementGroup) -> None:
        self._group = group

    def hold(self, p: Array, memory: Array, held: Array, h: float) -> None:
        """See Relaxation."""
        held[:] = held_stress(self._group, p, memory, h)

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """See Relaxation."""
        remember(self._group, p, memory, positions, h)


def relaxation(group: ElementGroup, compiled: bool) -> Relaxation:
    """That of a group, by kernels where the step is `compiled` and its law has them."""
    if compiled and len(group.cells):
        from softsim_core.dynamics.numba_backend.laws import compiled_law
        from softsim_core.dynamics.numba_backend.relaxing_cells import RelaxingCells

        if compiled_law(group.material) is not None:
            return RelaxingCells(group)
    return PlainRelaxation(group)
