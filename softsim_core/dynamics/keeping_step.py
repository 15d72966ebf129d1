"""The step of actuators that keep something from step to step, such as a line's air, around any other."""

from __future__ import annotations

from dataclasses import replace

from softsim_core.dynamics.report import StepReport
from softsim_core.dynamics.stepper import FreeMotion, StepperAround
from softsim_core.mechanics.control import Control, Parameters
from softsim_core.mechanics.state import State


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
