"""Internal state of bodies and actuators, advanced once per step: relaxing stress, gas in a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from softsim_core.base import Array
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.stepper import FreeMotion, Stepper, StepperAround
from softsim_core.physics.fem import ElementGroup, during_step, forget, held_stress, remember
from softsim_core.physics.fem.materials import Relaxing
from softsim_core.physics.mechanics import Control, Model, Parameters, State, held_name, memory_name


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
        from softsim_core.physics.dynamics.numba_backend.cells import RelaxingCells, compiled_law

        if compiled_law(group.material) is not None:
            return RelaxingCells(group)
    return PlainRelaxation(group)


def relaxing_groups(model: Model) -> list[tuple[int, ElementGroup]]:
    """Groups of a relaxing law, with their places in the model."""
    return [(k, group) for k, group in enumerate(model.groups) if isinstance(group.material, Relaxing)]


def let_relax(model: Model, state: State, parameters: Parameters) -> None:
    """All that fades has faded where a state is."""
    for k, group in relaxing_groups(model):
        p = group.values(parameters.materials)
        forget(group, p, state.extra[memory_name(k)], state.positions)


class ViscousStepper(StepperAround):
    """Tells the inner step what is held, and remembers what it did.

    Args:
        inner: The step of everything else.
    """

    def __init__(self, inner: Stepper) -> None:
        super().__init__(inner)
        self._groups = [
            (k, group, relaxation(group, inner.compiled)) for k, group in relaxing_groups(inner.model)
        ]

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """See Stepper."""
        report = self._inner.step(state, control, self._prepared(state, parameters))
        for p, memory, _, relaxing in self._arrays(state, parameters):
            relaxing.remember(p, memory, state.positions, self.model.dt)
        return report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """See Stepper."""
        return self._inner.free_motion(state, control, self._prepared(state, parameters))

    def _prepared(self, state: State, parameters: Parameters) -> Parameters:
        """Write down what is held during a step; returns the parameters for it."""
        for p, memory, held, relaxing in self._arrays(state, parameters):
            relaxing.hold(p, memory, held, self.model.dt)
        materials = [
            during_step(self.model.law(body), values, self.model.dt)
            for body, values in enumerate(parameters.materials)
        ]
        return replace(parameters, materials=materials)

    def _arrays(
        self, state: State, parameters: Parameters
    ) -> Iterator[tuple[Array, Array, Array, Relaxation]]:
        for k, group, relaxing in self._groups:
            p = group.values(parameters.materials)
            yield p, state.extra[memory_name(k)], state.extra[held_name(k)], relaxing


class KeepingStepper(StepperAround):
    """Asks the actuators what they keep during a step, and has them take note of how it ended.

    Args:
        inner: The step of everything else.
    """

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """See Stepper."""
        report = self._inner.step(state, self._begun(state, control), parameters)
        self.actuators.end(state, control.targets, self.model.dt)
        return report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """See Stepper."""
        return self._inner.free_motion(state, self._begun(state, control), parameters)

    def _begun(self, state: State, control: Control) -> Control:
        kept = self.actuators.begin(state, control.targets, self.model.dt)
        return replace(control, transmissions=kept)
