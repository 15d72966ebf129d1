"""How much bodies strain within a step, compiled where the step is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from softsim_core.arrays import Array
from softsim_core.fem.cells import strain_change
from softsim_core.fem.group import ElementGroup


def strain_measure(group: ElementGroup, compiled: bool) -> Callable[[Array, Array], float]:
    """Measures the largest change of strain of a group between positions (n, 3); see fem.cells."""
    if not compiled or not len(group.cells):
        return partial(strain_change, group)
    from softsim_core.dynamics.numba_backend.batches import cell_batches, largest_strain_change
    from softsim_core.kernels import OneSignature

    return partial(OneSignature(largest_strain_change), cell_batches(group))
