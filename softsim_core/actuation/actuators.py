"""All actuators of a model, one behind the other: their rows, values, bounds, stiffness and views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from softsim_core.actuation.actuator import (
    Actuator,
    ActuatorView,
    GeometricStiffness,
    no_geometric_stiffness,
)
from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.mechanics.control import Control, Transmissions
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows, joined
from softsim_core.mechanics.state import COMMANDED, EFFORT_CHANGE, KEPT, State


class Constraints(NamedTuple):
    """What never changes in the rows of c actuators.

    Attributes:
        joint: Joint of each, shape (c,).
        start: Where the entries of each row begin; the last one ends them, shape (c + 1,).
        place: Node, or number of nodes + reduced coordinate, of each entry, shape (k,).
        by_multiplier: Whether the command is the multiplier, shape (c,).
    """

    joint: IndexArray
    start: IndexArray
    place: IndexArray
    by_multiplier: BoolArray


class ActuatorGroup(Protocol):
    """Actuators of one kind, evaluated together; c of them, k entries in their rows."""

    @property
    def constraints(self) -> Constraints:
        """What never changes in their rows."""
        ...

    def values(self, model: Model, state: State) -> Array:
        """Coordinates s, shape (c,)."""
        ...

    def coefficients(self, model: Model, state: State) -> Array:
        """Entries of the rows H, shape (k, 3)."""
        ...

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """What they keep at rest under their commands (c,), linearised at multipliers (c,)."""
        ...

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """The commands (c,) under which they rest at coordinates (c,) with multipliers (c,)."""
        ...

    def keeping(self) -> list[tuple[int, Actuator]]:
        """Those that keep numbers from step to step, with their places among the c."""
        ...

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """-d(H^T t)/dx at multipliers t (c,); `without_surfaces`: less that of `surfaces`."""
        ...

    def surfaces(self) -> list[IndexArray]:
        """Nodes of the faces of each actuator that presses on some, shapes (m, a)."""
        ...

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Their geometric stiffness at multipliers t (c,); see Actuator.surface_stiffness."""
        ...

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[ActuatorView, ...]:
        """What one can see of each."""
        ...


class PlainGroup:
    """Actuators in NumPy, one after the other."""

    def __init__(self, actuators: Sequence[Actuator]) -> None:
        self._actuators = tuple(actuators)
        sizes = [len(each.place) for each in self._actuators]
        self.constraints = Constraints(
            np.array([each.joint for each in self._actuators], dtype=np.int64),
            np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes, dtype=np.int64)]),
            np.concatenate([np.zeros(0, np.int64), *(each.place for each in self._actuators)]),
            np.array([each.by_multiplier for each in self._actuators], dtype=np.bool_),
        )

    def values(self, model: Model, state: State) -> Array:
        """See ActuatorGroup."""
        return np.array([each.value(model, state) for each in self._actuators], dtype=float)

    def coefficients(self, model: Model, state: State) -> Array:
        """See ActuatorGroup."""
        return np.concatenate([np.zeros((0, 3)), *(each.row(model, state) for each in self._actuators)])

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """See ActuatorGroup."""
        table = np.empty((5, len(self._actuators)))
        for c, each in enumerate(self._actuators):
            table[:, c] = each.transmission(float(commands[c]), float(multipliers[c]))
        return Transmissions(*table)

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """See ActuatorGroup."""
        given = zip(self._actuators, values.tolist(), multipliers.tolist(), strict=True)
        return np.array([each.command_of(s, t) for each, s, t in given], dtype=float)

    def keeping(self) -> list[tuple[int, Actuator]]:
        """See ActuatorGroup."""
        return [(c, each) for c, each in enumerate(self._actuators) if each.keeps]

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """See ActuatorGroup."""
        return _joined_stiffness(
            [
                each.geometric_stiffness(model, state, float(t))
                for each, t in zip(self._actuators, multipliers, strict=True)
                if each.surface is None or not without_surfaces
            ]
        )

    def surfaces(self) -> list[IndexArray]:
        """See ActuatorGroup."""
        return [each.surface for each in self._actuators if each.surface is not None]

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """See ActuatorGroup."""
        return [
            each.surface_stiffness(state, float(t))
            for each, t in zip(self._actuators, multipliers, strict=True)
            if each.surface is not None
        ]

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[ActuatorView, ...]:
        """See ActuatorGroup."""
        return tuple(
            each.view(model, state, float(t)) for each, t in zip(self._actuators, multipliers, strict=True)
        )


class Actuators:
    """All actuators that constrain a model, group behind group.

    The drives of joints with a frame are no part of it: their rows are unit vectors, which the step takes
    into its matrix instead; see joint_drive.

    Args:
        groups: Groups of one kind each.

    Attributes:
        groups: The groups.
        constraints: What never changes in all rows.
        joint: Joint of each actuator, shape (c,).
        multiplied: Joints commanded by a multiplier.
        keeps: How many numbers all of them keep from step to step, in State.extra["actuators"].
        paced: Joints whose command is no coordinate, but what drives it: a multiplier, or what a pump does.
    """

    def __init__(self, groups: Sequence[ActuatorGroup] = ()) -> None:
        self.groups = tuple(groups)
        parts = [group.constraints for group in self.groups]
        self._rows = np.concatenate([[0], np.cumsum([len(part.joint) for part in parts])]).astype(int)
        self._entries = np.concatenate([[0], np.cumsum([len(part.place) for part in parts])]).astype(int)
        index = np.zeros(0, np.int64)
        starts = [part.start[:-1] + end for part, end in zip(parts, self._entries[:-1], strict=True)]
        self.constraints = Constraints(
            np.concatenate([index, *(part.joint for part in parts)]),
            np.concatenate([index, *starts, self._entries[-1:]]),
            np.concatenate([index, *(part.place for part in parts)]),
            np.concatenate([np.zeros(0, np.bool_), *(part.by_multiplier for part in parts)]),
        )
        self.joint = self.constraints.joint
        self._none = Transmissions(*np.zeros((5, 0)))
        self.multiplied: IndexArray = self.joint[self.constraints.by_multiplier]
        first = self._rows.tolist()
        keeping = [(first[g] + c, each) for g, group in enumerate(self.groups) for c, each in group.keeping()]
        ends = np.cumsum([0, *(each.keeps for _, each in keeping)]).tolist()
        self.keeps: int = ends[-1]
        self._keeping = [
            (row, each, slice(*ends[k : k + 2])) for k, (row, each) in enumerate(keeping)
        ]  # row, actuator, its part of what is kept
        self.paced: IndexArray = np.union1d(self.multiplied, self.joint[[row for row, _ in keeping]])

    def __len__(self) -> int:
        return len(self.joint)

    def spans(self) -> list[tuple[ActuatorGroup, slice, slice]]:
        """Each group with its rows and its entries among all of them."""
        rows, entries = self._rows.tolist(), self._entries.tolist()
        return [
            (group, slice(rows[g], rows[g + 1]), slice(entries[g], entries[g + 1]))
            for g, group in enumerate(self.groups)
        ]

    def values(self, model: Model, state: State) -> Array:
        """Coordinates s of all actuators, shape (c,)."""
        return np.concatenate([np.zeros(0), *(group.values(model, state) for group in self.groups)])

    def rows(self, model: Model, state: State) -> Rows:
        """H = ds/dx of all actuators on nodes, frames and joints."""
        parts = [group.coefficients(model, state) for group in self.groups]
        coefficient = np.concatenate([np.zeros((0, 3)), *parts])
        return Rows(self.constraints.start, self.constraints.place, coefficient)

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """What all actuators keep at rest under their commands (c,), linearised at multipliers (c,)."""
        if not self.groups:
            return self._none
        if len(self.groups) == 1:
            return self.groups[0].transmissions(commands, multipliers)
        parts = [group.transmissions(commands[rows], multipliers[rows]) for group, rows, _ in self.spans()]
        return Transmissions(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """The commands (c,) under which all rest at coordinates (c,) with multipliers (c,)."""
        parts = [group.commands_of(values[rows], multipliers[rows]) for group, rows, _ in self.spans()]
        return np.concatenate([np.zeros(0), *parts])

    def kept_in(self, state: State, control: Control) -> Transmissions:
        """What all actuators keep in a step from a state: what the control says, else what targets say."""
        if control.transmissions is not None:
            return control.transmissions
        return self.transmissions(control.targets[self.joint], state.joint_efforts[self.joint])

    def begin(self, state: State, commands: Array, span: float) -> Transmissions:
        """What all keep in a step of `span` [s] from a state, under the commands of all joints (j,)."""
        own = commands[self.joint]
        result = self.transmissions(own, state.joint_efforts[self.joint])
        for row, actuator, part in self._keeping:
            found = actuator.begin(state, state.extra[KEPT][part], float(own[row]), span)
            for array, value in zip(result, found, strict=True):
                array[row] = value
        return result

    def end(self, state: State, commands: Array, span: float) -> None:
        """Take note of a step of `span` [s] that ended in a state, under the commands of all joints (j,)."""
        for row, actuator, part in self._keeping:
            actuator.end(state, state.extra[KEPT][part], float(commands[self.joint[row]]), span)

    def settle(self, state: State, commands: Array) -> None:
        """Take note that a state is at rest under the commands of all joints (j,)."""
        if COMMANDED in state.extra:
            state.extra[COMMANDED][:], state.extra[EFFORT_CHANGE][:] = commands, 0.0
        for row, actuator, part in self._keeping:
            actuator.settle(state, state.extra[KEPT][part], float(commands[self.joint[row]]))

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """-d(H^T t)/dx of all actuators at multipliers t (c,); `without_surfaces`: see ActuatorGroup."""
        return _joined_stiffness(
            [
                group.geometric_stiffness(model, state, multipliers[rows], without_surfaces)
                for group, rows, _ in self.spans()
            ]
        )

    def surfaces(self) -> list[IndexArray]:
        """Nodes of the faces of each actuator that presses on some, shapes (m, a)."""
        return [each for group in self.groups for each in group.surfaces()]

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Their geometric stiffness at multipliers t (c,); see Actuator.surface_stiffness."""
        return [
            each
            for group, rows, _ in self.spans()
            for each in group.surface_stiffness(state, multipliers[rows])
        ]

    def views(self, model: Model, state: State) -> tuple[ActuatorView, ...]:
        """What one can see of each actuator, in joint order."""
        multipliers = state.joint_efforts[self.joint]
        views = [
            view for group, rows, _ in self.spans() for view in group.views(model, state, multipliers[rows])
        ]
        return tuple(views[c] for c in np.argsort(self.joint, kind="stable"))

    def measure(self, model: Model, state: State) -> None:
        """Write the coordinates s as positions of their joints: where they are, not where they are told."""
        if len(self):
            state.joint_positions[self.joint] = self.values(model, state)

    def report(self, model: Model, state: State, before: Array, multipliers: Array) -> None:
        """Write multipliers (c,), coordinates, and their rates since those `before` (c,), a step ago."""
        if len(self):
            state.joint_efforts[self.joint] = multipliers
            self.measure(model, state)
            first = len(state.reduced_velocities) - len(state.joint_positions)
            moved = state.joint_positions[self.joint] - before
            state.reduced_velocities[first + self.joint] = moved / model.dt


def _joined_stiffness(parts: Sequence[GeometricStiffness]) -> GeometricStiffness:
    if len(parts) < 2:
        return parts[0] if parts else no_geometric_stiffness()
    return GeometricStiffness(
        joined([part.rows for part in parts]), np.concatenate([part.weight for part in parts])
    )
