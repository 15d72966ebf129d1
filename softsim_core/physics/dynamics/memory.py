"""Internal state of bodies and actuators, advanced once per step: relaxing stress, gas in a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from softsim_core.base import Array
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.stepper import FreeMotion, Stepper, StepperAround
from softsim_core.physics.fem import ElementGroup, during_step, forget, remember, step_stress
from softsim_core.physics.fem.materials import Relaxing
from softsim_core.physics.mechanics import Control, Model, Parameters, State, memory_name, step_stress_name


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
        from softsim_core.physics.dynamics.numba_backend.cells import RelaxingCells, compiled_law

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


class ViscousStepper(StepperAround):
    """Step that adds viscoelastic stress to the inner step, and updates the cells' memory afterwards.

    Args:
        inner: Step of everything else.
    """

    def __init__(self, inner: Stepper) -> None:
        super().__init__(inner)
        self._groups = [
            (k, group, relaxation(group, inner.compiled)) for k, group in relaxing_groups(inner.model)
        ]

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt with viscoelastic stress, and update the cells' memory."""
        report = self._inner.step(state, control, self._prepare_step(state, parameters))
        for p, memory, _, relaxing in self._arrays(state, parameters):
            relaxing.remember(p, memory, state.positions, self.model.dt)
        return report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """Return the unconstrained step with viscoelastic stress; the cells' memory is unchanged."""
        return self._inner.free_motion(state, control, self._prepare_step(state, parameters))

    def _prepare_step(self, state: State, parameters: Parameters) -> Parameters:
        """Write the known stress of the step into the state; return the parameters for the inner step."""
        for p, memory, stress, relaxing in self._arrays(state, parameters):
            relaxing.hold(p, memory, stress, self.model.dt)
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
            yield p, state.extra[memory_name(k)], state.extra[step_stress_name(k)], relaxing


class ActuatorStateStepper(StepperAround):
    """Step that advances the internal state of actuators, such as the gas mass of a pressure line.

    Args:
        inner: Step of everything else.
    """

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt, then the internal state of the actuators."""
        report = self._inner.step(state, self._begun(state, control), parameters)
        self.actuators.end(state, control.targets, self.model.dt)
        return report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """Return the unconstrained step; the internal state of the actuators is unchanged."""
        return self._inner.free_motion(state, self._begun(state, control), parameters)

    def _begun(self, state: State, control: Control) -> Control:
        transmissions = self.actuators.begin(state, control.targets, self.model.dt)
        return replace(control, transmissions=transmissions)
