"""The step of bodies whose stress relaxes, around one of bodies whose stress does not; see fem.prony."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from softsim_core.arrays import Array
from softsim_core.dynamics.relaxation import Relaxation, relaxation
from softsim_core.dynamics.report import StepReport
from softsim_core.dynamics.stepper import FreeMotion, Stepper, StepperAround
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.relaxing import Relaxing
from softsim_core.fem.prony import during_step, forget
from softsim_core.mechanics.control import Control, Parameters
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State, held_name, memory_name


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
