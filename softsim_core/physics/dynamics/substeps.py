"""Steps that are halved, repeatedly, where a body strains too much for one step.

A step is linearised once, which is accurate as long as no body changes its strain much within it. A soft body
that hits something may be crushed by half in a single step, and be torn apart by the next. Such a step is
therefore taken back and repeated in halves, which are halved again where they are still too rough.

Joints move half of their way in the first half: actuators from their previous command, since a coordinate may
differ from its command at rest, all others from their position. The reported forces (joint efforts and
contacts) are means over time, so that times dt they are the impulses of the step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from softsim_core.base import Array, FactorisationError
from softsim_core.physics.dynamics.report import ContactReport, StepReport, mean_contacts
from softsim_core.physics.dynamics.stepper import Stepper, StepperAround
from softsim_core.physics.fem import ElementGroup, mean_volume_law, strain_change
from softsim_core.physics.fem.materials import Fibres, RotatedHooke
from softsim_core.physics.mechanics import COMMANDED, EFFORT_CHANGE, Control, Parameters, State


def strain_measure(group: ElementGroup, compiled: bool) -> Callable[[Array, Array], float]:
    """Return a function of two position arrays (n, 3) that gives a group's largest change of strain.

    See fem.cells.strain_change.
    """
    if not compiled or not len(group.cells):
        return partial(strain_change, group)
    from softsim_core.physics.dynamics.numba_backend.cells import cell_batches, largest_strain_change
    from softsim_core.physics.kernels import OneSignature

    return partial(OneSignature(largest_strain_change), cell_batches(group))


ROUGH: Final = 0.3
"""Change of the Green strain at a point within one step at which the step is cut."""


def torn_by_rough_steps(groups: Sequence[ElementGroup]) -> list[ElementGroup]:
    """Return the cells to be watched.

    Fibres, and linear cells that only rotate, are not watched, because they withstand being crushed.
    """
    stand = RotatedHooke, Fibres
    return [
        each for each in groups if mean_volume_law(each) is not None or not isinstance(each.material, stand)
    ]


class _Part(NamedTuple):
    """Result of a part of a step: its share of dt, joint efforts (j,), contacts."""

    share: float
    efforts: Array
    contacts: ContactReport


class SubstepStepper(StepperAround):
    """Step in as few equal parts as the strains allow, 1, 2, 4 and so on.

    Args:
        whole: Step of the model's dt.
        of_part: Makes the same step with another dt in [s].
        groups: Cells that are watched.
        most: Largest number of parts.
    """

    def __init__(
        self,
        whole: Stepper,
        of_part: Callable[[float], Stepper],
        groups: Sequence[ElementGroup],
        most: int,
    ) -> None:
        super().__init__(whole)
        self._steppers, self._of_part = [whole], of_part
        self._changes = [strain_measure(group, whole.compiled) for group in groups]
        self._deepest = int(most).bit_length() - 1
        self._before = [whole.model.empty_state() for _ in range(self._deepest + 1)]
        self._parts: list[_Part] = []

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt in as many substeps as contacts need, and report the mean contacts."""
        change = state.extra.get(EFFORT_CHANGE)
        if change is not None:  # actuators continue from their last effort, not from the mean
            state.joint_efforts += change
            change[:] = 0.0
        self._parts.clear()
        report = self._advance(state, control, parameters, 0)
        if report.parts == 1:
            return report
        parts = [(part.share, part.contacts) for part in self._parts]
        if change is not None:
            last = state.joint_efforts.copy()
            state.joint_efforts[:] = sum(part.share * part.efforts for part in self._parts)
            change[:] = last - state.joint_efforts
        return replace(report, measure=lambda: mean_contacts(parts))

    def _advance(self, state: State, control: Control, parameters: Parameters, depth: int) -> StepReport:
        """Advance by a part, which is dt halved `depth` times."""
        stepper, before = self._stepper(depth), self._before[depth]
        before.copy_from(state)
        try:
            report = stepper.step(state, control, parameters)
            if depth == self._deepest or self._is_smooth(before, state):
                self._note(state, control, report, depth)
                return report
        except FactorisationError:
            if depth == self._deepest:
                raise
            report = StepReport()
        state.copy_from(before)
        first = self._advance(state, self._halfway(state, control), parameters, depth + 1)
        second = self._advance(state, control, parameters, depth + 1)
        times = Counter(report.times) + Counter(first.times) + Counter(second.times)
        return replace(second, times=dict(times), parts=first.parts + second.parts)

    def _note(self, state: State, control: Control, report: StepReport, depth: int) -> None:
        """Record the command, the efforts and the contacts of a part."""
        if COMMANDED in state.extra:
            state.extra[COMMANDED][:] = control.targets
        if depth:
            self._parts.append(_Part(0.5**depth, state.joint_efforts.copy(), report.contacts))

    def _is_smooth(self, before: State, after: State) -> bool:
        """Return whether no body has changed its strain much."""
        return all(change(before.positions, after.positions) < ROUGH for change in self._changes)

    def _stepper(self, depth: int) -> Stepper:
        while len(self._steppers) <= depth:
            self._steppers.append(self._of_part(self.model.dt / 2 ** len(self._steppers)))
        return self._steppers[depth]

    def _halfway(self, state: State, control: Control) -> Control:
        """Return the control of the first half: half of each motion; forces and springs unchanged."""
        begun = state.joint_positions.copy()
        for j in self.actuators.joint:
            begun[j] = state.extra[COMMANDED][j]
        targets = 0.5 * (begun + control.targets)
        driven = np.union1d(self.model.compliant_joints, self.actuators.paced)
        targets[driven] = control.targets[driven]
        shift = 0.5 * (float(state.base_shift[0]) + control.base_shift)
        return replace(control, targets=targets, base_shift=shift)
