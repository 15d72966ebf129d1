"""Viscoelastic memory of bodies, advanced once per step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from softsim_core.base import Array
from softsim_core.physics.fem import ElementGroup, during_step, forget, remember, step_stress
from softsim_core.physics.fem.materials import Relaxing
from softsim_core.physics.mechanics import Model, Parameters, State, memory_name, step_stress_name


class Relaxation(Protocol):
    """Viscoelastic memory of one group of cells, advanced as in fem.prony."""

    def hold(self, p: Array, memory: Array, stress: Array, h: float) -> None:
        """Write the stress that is known in a step of h [s] into `stress`; see fem.prony.step_stress."""
        ...

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """Advance `memory` in place after a step of h [s] to node positions (n, 3)."""
        ...


class PlainRelaxation:
    """Viscoelastic memory of a group of any law, in NumPy."""

    def __init__(self, group: ElementGroup) -> None:
        self._group = group

    def hold(self, p: Array, memory: Array, stress: Array, h: float) -> None:
        """Write the stress H that is known at the start of a step of h [s] into `stress`."""
        stress[:] = step_stress(self._group, p, memory, h)

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """Advance `memory` in place after a step of h [s] to node positions (n, 3)."""
        remember(self._group, p, memory, positions, h)


def relaxation(group: ElementGroup, compiled: bool) -> Relaxation:
    """Return the relaxation of a group, by kernels where the step is `compiled` and its law has them."""
    if compiled and len(group.cells):
        from softsim_core.physics.dynamics.numba_backend import RelaxingCells, compiled_law

        if compiled_law(group.material) is not None:
            return RelaxingCells(group)
    return PlainRelaxation(group)


def relaxing_groups(model: Model) -> list[tuple[int, ElementGroup]]:
    """Return the groups with a relaxing law, with their index in the model."""
    return [(k, group) for k, group in enumerate(model.groups) if isinstance(group.material, Relaxing)]


def let_relax(model: Model, state: State, parameters: Parameters) -> None:
    """Reset the memory of all groups to the fully relaxed state at the present positions."""
    for k, group in relaxing_groups(model):
        p = group.values(parameters.materials)
        forget(group, p, state.extra[memory_name(k)], state.positions)


class Memory:
    """Viscoelastic memory of all groups of cells of a model, for steps of its dt.

    Args:
        model: The model.
        compiled: Whether the step is compiled.
    """

    def __init__(self, model: Model, compiled: bool) -> None:
        self._model = model
        self._groups = [(k, group, relaxation(group, compiled)) for k, group in relaxing_groups(model)]

    def begin(self, state: State, parameters: Parameters) -> Parameters:
        """Write the stress that is known in a step into the state; return the parameters of the step."""
        if not self._groups:
            return parameters
        for p, memory, stress, relaxing in self._arrays(state, parameters):
            relaxing.hold(p, memory, stress, self._model.dt)
        materials = [
            during_step(self._model.law(body), values, self._model.dt)
            for body, values in enumerate(parameters.materials)
        ]
        return replace(parameters, materials=materials)

    def end(self, state: State, parameters: Parameters) -> None:
        """Advance the memory in the state after a step that has ended there.

        Args:
            state: State at the end of the step.
            parameters: Parameters that `begin` was called with.
        """
        for p, memory, _, relaxing in self._arrays(state, parameters):
            relaxing.remember(p, memory, state.positions, self._model.dt)

    def _arrays(
        self, state: State, parameters: Parameters
    ) -> Iterator[tuple[Array, Array, Array, Relaxation]]:
        for k, group, relaxing in self._groups:
            p = group.values(parameters.materials)
            yield p, state.extra[memory_name(k)], state.extra[step_stress_name(k)], relaxing
