"""Parts of a step that is halved, repeatedly, where a body strains or moves too much for one step.

A step is linearised once, which is accurate as long as no body changes its strain much within it. A soft body
that hits something may be crushed by half in a single step, and be torn apart by the next. Something that
moves by more than its size meets other faces at the end of the step than at its start. Such a step is
therefore taken back and repeated in halves, which are halved again where they are still too rough.

Joints move half of their way in the first half: actuators from their previous command, since a coordinate may
differ from its command at rest, all others from their position. The reported forces (joint efforts and
contacts) are means over time, so that times dt they are the impulses of the step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics.report import ContactReport, StepReport, mean_contacts
from softsim_core.physics.fem import ElementGroup, mean_volume_law, strain_change
from softsim_core.physics.fem.materials import Fibres, RotatedHooke
from softsim_core.physics.mechanics import COMMANDED, EFFORT_CHANGE, Control, Model, State


def strain_measure(group: ElementGroup, compiled: bool) -> Callable[[Array, Array], float]:
    """Return a function of two position arrays (n, 3) that gives a group's largest change of strain.

    See fem.cells.strain_change.
    """
    if not compiled or not len(group.cells):
        return partial(strain_change, group)
    from softsim_core.physics.dynamics.numba_backend import cell_batches, largest_strain_change
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


class StrainWatch:
    """Change of strain within a step in the cells of some groups, by kernels where the step is `compiled`."""

    def __init__(self, groups: Sequence[ElementGroup], compiled: bool) -> None:
        self._changes = [strain_measure(group, compiled) for group in groups]

    def is_rough(self, before: State, after: State) -> bool:
        """Return whether a cell has changed its strain too much between two states."""
        return not all(change(before.positions, after.positions) < ROUGH for change in self._changes)


def control_of_first_half(model: Model, actuators: Actuators, state: State, control: Control) -> Control:
    """Return the control of the first half of a step from `state`.

    Motions go half of their way; forces, springs and pressures are unchanged.
    """
    begun = state.joint_positions.copy()
    for j in actuators.joint:
        begun[j] = state.extra[COMMANDED][j]
    targets = 0.5 * (begun + control.targets)
    driven = np.union1d(model.compliant_joints, actuators.paced)
    targets[driven] = control.targets[driven]
    shift = 0.5 * (float(state.base_shift[0]) + control.base_shift)
    return replace(control, targets=targets, base_shift=shift)


class _Part(NamedTuple):
    """A part of a step: its share of dt, joint efforts (j,), contacts."""

    share: float
    efforts: Array
    contacts: ContactReport


class StepParts:
    """Accepted parts of one step, and the report of all of them.

    Args:
        state: State at the start of the step; its efforts become those of the end of the previous step, from
            which actuators continue, instead of the mean over it.

    Attributes:
        times: Times of each part, also of those taken back, see StepReport.
    """

    def __init__(self, state: State) -> None:
        self.times: list[Mapping[str, float]] = []
        self._parts, self._count = list[_Part](), 0
        change = state.extra.get(EFFORT_CHANGE)
        if change is not None:
            state.joint_efforts += change
            change[:] = 0.0

    def accept(self, share: float, state: State, control: Control, report: StepReport) -> None:
        """Add a part that has ended in `state`, with its share of dt."""
        self._count += 1
        if COMMANDED in state.extra:
            state.extra[COMMANDED][:] = control.targets
        if share < 1.0:  # contacts are measured now, because the next part changes what they are measured on
            self._parts.append(_Part(share, state.joint_efforts.copy(), report.contacts))

    def finish(self, state: State, last: StepReport) -> StepReport:
        """Set the efforts in `state` to their mean over the step; return its report.

        `last` is the report of the last part.
        """
        if self._count == 1:
            return last
        if (change := state.extra.get(EFFORT_CHANGE)) is not None:
            end = state.joint_efforts.copy()
            state.joint_efforts[:] = sum(part.share * part.efforts for part in self._parts)
            change[:] = end - state.joint_efforts
        contacts = [(part.share, part.contacts) for part in self._parts]
        times = Counter[str]()
        for each in self.times:
            times.update(each)
        return replace(last, times=dict(times), parts=self._count, measure=partial(mean_contacts, contacts))
