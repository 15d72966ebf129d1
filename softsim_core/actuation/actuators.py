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
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows, joined
from softsim_core.mechanics.state import State


class Constraints(NamedTuple):
    """What never changes in the rows of c actuators.

    Attributes:
        joint: Joint of each, shape (c,).
        start: Where the entries of each row begin; the last one ends them, shape (c + 1,).
        place: Node, or number of nodes + reduced coordinate, of each entry, shape (k,).
        compliance: c in s - q + c t = 0, shape (c,).
        by_multiplier: Whether the command is the multiplier, shape (c,).
    """

    joint: IndexArray
    start: IndexArray
    place: IndexArray
    compliance: Array
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

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """Bounds of the multipliers under their commands (c,), shapes (c,)."""
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
        """Their geometric stiffness at multipliers t (c,) in [N/m], shapes (m, a, a, 3, 3)."""
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
            np.array([each.compliance for each in self._actuators], dtype=float),
            np.array([each.by_multiplier for each in self._actuators], dtype=np.bool_),
        )

    def values(self, model: Model, state: State) -> Array:
        """See ActuatorGroup."""
        return np.array([each.value(model, state) for each in self._actuators], dtype=float)

    def coefficients(self, model: Model, state: State) -> Array:
        """See ActuatorGroup."""
        return np.concatenate([np.zeros((0, 3)), *(each.row(model, state) for each in self._actuators)])

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """See ActuatorGroup."""
        pairs = [each.bounds(float(q)) for each, q in zip(self._actuators, commands, strict=True)]
        table = np.array(pairs, dtype=float).reshape(-1, 2)
        return table[:, 0].copy(), table[:, 1].copy()

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
        compliance: See Constraints.
        multiplied: Joints commanded by a multiplier.
    """

    def __init__(self, groups: Sequence[ActuatorGroup] = ()) -> None:
        self.groups = tuple(groups)
        parts = [group.constraints for group in self.groups]
        self._rows = np.concatenate([[0], np.cumsum([len(part.joint) for part in parts])]).astype(int)
        self._entries = np.concatenate([[0], np.cumsum([len(part.place) for part in parts])]).astype(int)
        none, index = np.zeros(0), np.zeros(0, np.int64)
        starts = [part.start[:-1] + end for part, end in zip(parts, self._entries[:-1], strict=True)]
        self.constraints = Constraints(
            np.concatenate([index, *(part.joint for part in parts)]),
            np.concatenate([index, *starts, self._entries[-1:]]),
            np.concatenate([index, *(part.place for part in parts)]),
            np.concatenate([none, *(part.compliance for part in parts)]),
            np.concatenate([np.zeros(0, np.bool_), *(part.by_multiplier for part in parts)]),
        )
        self.joint = self.constraints.joint
        self.compliance = self.constraints.compliance
        self._unbounded = none, none
        self.multiplied: IndexArray = self.joint[self.constraints.by_multiplier]

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

    def violations(self, model: Model, state: State, commands: Array) -> Array:
        """How far s is beyond q, of all actuators under the commands of all joints (j,), shape (c,)."""
        return np.asarray(self.values(model, state) - commands[self.joint])

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """Bounds of the multipliers under the commands of all joints (j,), shapes (c,)."""
        if not self.groups:
            return self._unbounded
        if len(self.groups) == 1:
            return self.groups[0].bounds(commands[self.joint])
        own, none = commands[self.joint], np.zeros(0)
        pairs = [group.bounds(own[rows]) for group, rows, _ in self.spans()]
        lower, upper = (np.concatenate([none, *(pair[side] for pair in pairs)]) for side in (0, 1))
        return lower, upper

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
        """Their geometric stiffness at multipliers t (c,) in [N/m], shapes (m, a, a, 3, 3)."""
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
    if not parts:
        return no_geometric_stiffness()
    return GeometricStiffness(
        joined([part.rows for part in parts]), np.concatenate([part.weight for part in parts])
    )
