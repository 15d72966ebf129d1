"""Actuators: the interface of one kind, and all actuators of a model with their rows, values and bounds.

An actuator has a coordinate s(x) of the nodes and of the reduced coordinates (frames and joints), a command
q, and a multiplier t, which acts on the body as H^T t with the row H = ds/dx. With the compliance c of its
transmission, the step, statics and inverse control enforce

    s - q + c t = 0    while t is within its bounds; at a bound, t is fixed and s is free

A cable has its shortening as s and its tension as t, a chamber its volume and its pressure. Position control:
the multiplier is unknown. Force control (`by_multiplier`): the command prescribes the multiplier. Where a
transmission is not linear, as for the air of a line, q and c are those of its tangent at the present t: see
`transmission`. Internal state, such as an amount of air, is stored in the State: see `begin`. Every actuator
belongs to a joint of the scene. The joint's position is s, its effort is t, and its limits are those of the
command. A group may add further rows that no joint commands, such as friction: see PassiveRows.

A new kind must implement `place`, `value` and `row`; everything else has a default. Where the row turns with
the body, it must also implement `geometric_stiffness`. Statics need it, and so do the steps of bodies whose
cells take their stress from the last linear solve (rubber on quadratic cells). The stress under a taut cable
reduces the stiffness of such a body, and the cable restores it. With the first effect alone in the matrix,
stiffness-proportional damping would feed oscillations. Steps use the rows with weights above 0 or, instead of
rows, the `surface_stiffness` of an actuator that presses on faces.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.mechanics import (
    ACTUATOR_STATE,
    COMMANDED,
    EFFORT_CHANGE,
    PASSIVE_EFFORTS,
    Control,
    Model,
    Rows,
    State,
    Transmissions,
    cross_matrices,
    join_rows,
    no_rows,
)


class Transmission(NamedTuple):
    """Constraint of an actuator, s - q + c t = 0 while t is within its bounds.

    Attributes:
        command: q.
        compliance: c >= 0.
        lower, upper: Bounds of t; equal ones impose it.
        gain: Change of q per unit of the command.
    """

    command: float
    compliance: float
    lower: float
    upper: float
    gain: float = 1.0


class GeometricStiffness(NamedTuple):
    """Geometric stiffness of multipliers, -d(H^T t)/dx = R^T diag(w) R.

    Attributes:
        rows: R on nodes and reduced coordinates.
        weight: w in [N/m] (for rows without unit) of each row, of either sign and not 0, shape (rows,).
    """

    rows: Rows
    weight: Array


class MeasuredSize(NamedTuple):
    """Size of an actuator as a sensor measures it, linear in its coordinate s: at_zero + sign s.

    Attributes:
        at_zero: Size at s = 0, such as a length in [m] or a volume in [m^3].
        sign: Change of the size per unit of s, 1 or -1.
    """

    at_zero: float
    sign: float


@dataclass(frozen=True, slots=True, eq=False)
class ActuatorView:
    """Visible state of an actuator.

    Attributes:
        name: Name of its joint.
        kind: Name of its kind, such as "cable".
        points: Points of the line that represents it in [m], world axes, shape (k, 3); may be empty.
        value: Its coordinate s, in [m] for a cable.
        multiplier: Its multiplier t, in [N] for a cable.
        pulled_from_outside: Whether the first point, where the actuator starts, is outside the body.
        tensions: Tension of each segment between its points in [N], shape (k - 1,); empty: it has none.
        surface: Corners of the triangles that represent it in [m], world axes, shape (m, 3, 3).
    """

    name: str
    kind: str
    points: Array
    value: float
    multiplier: float
    pulled_from_outside: bool = False
    tensions: Array = field(default_factory=lambda: np.zeros(0))
    surface: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def measured_size(self) -> MeasuredSize:
        """What a sensor of its coordinate measures; by default the coordinate itself."""
        return MeasuredSize(0.0, 1.0)


class Actuator(ABC):
    """One actuator in NumPy.

    Args:
        name: Name of its joint.
        joint: Index of this joint in the model.
        place: Places on which its coordinate depends, the same in every state: indices of nodes, and number
            of nodes + reduced coordinate (see Model) of frames and joints, shape (k,).
        compliance: c >= 0: s - q + c t = 0, in [m/N] where s is a length.
        by_multiplier: Whether the command is t instead of s.
    """

    kind = "actuator"
    surface: IndexArray | None = None
    """Nodes of the faces that its multiplier presses on, shape (m, a); None: there are none."""
    keeps = 0
    """How many numbers of internal state it has."""

    def __init__(
        self,
        name: str,
        joint: int,
        place: IndexArray,
        *,
        compliance: float = 0.0,
        by_multiplier: bool = False,
    ) -> None:
        self.name, self.joint, self.place = name, joint, np.asarray(place, dtype=np.int64)
        self.compliance, self.by_multiplier = compliance, by_multiplier

    @abstractmethod
    def value(self, model: Model, state: State) -> float:
        """Return the coordinate s."""

    @abstractmethod
    def row(self, model: Model, state: State) -> Array:
        """Return H = ds/dx at `place`, shape (k, 3); for frames and joints only the first column counts."""

    def bounds(self, command: float) -> tuple[float, float]:
        """Return the smallest and largest multiplier under a command.

        The command is q, or the wanted t with `by_multiplier`. Equal bounds impose the multiplier.
        """
        return (command, command) if self.by_multiplier else (-math.inf, math.inf)

    def transmission(self, command: float, multiplier: float) -> Transmission:
        """Return the constraint at rest under a command, linearised at a multiplier."""
        return Transmission(command, self.compliance, *self.bounds(command))

    def command_of(self, value: float, multiplier: float) -> float:
        """Return the command under which it rests at a coordinate with a multiplier."""
        return multiplier if self.by_multiplier else value + self.compliance * multiplier

    def begin(self, state: State, internal: Array, command: float, span: float) -> Transmission:
        """Return the constraint of a step of `span` [s] from a state, given the `internal` state (k,).

        It is called only if `keeps` is not 0.
        """
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `begin`")

    def end(self, state: State, internal: Array, command: float, span: float) -> None:
        """Update the `internal` state (k,) in place after a step of `span` [s] that ended in a state."""
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `end`")

    def settle(self, state: State, internal: Array, command: float) -> None:
        """Set the `internal` state (k,) to its value at rest."""
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `settle`")

    def geometric_stiffness(self, model: Model, state: State, multiplier: float) -> GeometricStiffness:
        """Return -d(H^T t)/dx at a multiplier t; needed where H turns with the body."""
        return no_geometric_stiffness()

    def surface_stiffness(self, state: State, multiplier: float) -> Array:
        """Return the geometric stiffness face by face in [N/m], shape (m, 3, a, a).

        It consists of the vectors v of the blocks [v]x of all pairs of nodes. A uniform pressure has such
        blocks, and v_ab = -v_ba.
        """
        raise NotImplementedError(f"an actuator of kind {self.kind} with a surface has to say its stiffness")

    def view(self, model: Model, state: State, multiplier: float) -> ActuatorView:
        """Return its visible state."""
        return ActuatorView(self.name, self.kind, np.zeros((0, 3)), self.value(model, state), multiplier)


def pressed_blocks(vectors: Array) -> Array:
    """Return the blocks [v]x, shape (m, a, a, 3, 3), of vectors (m, 3, a, a).

    See Actuator.surface_stiffness.
    """
    return cross_matrices(np.moveaxis(vectors, 1, -1))


def no_geometric_stiffness() -> GeometricStiffness:
    """Return the geometric stiffness of an actuator with a constant row: none."""
    return GeometricStiffness(no_rows(), np.zeros(0))


class Constraints(NamedTuple):
    """Constant part of the rows of c actuators.

    Attributes:
        joint: Joint of each actuator, shape (c,); none for passive rows.
        start: First entry of each row, and the end of the last row, shape (c + 1,).
        place: Node, or number of nodes + reduced coordinate, of each entry, shape (k,).
        by_multiplier: Whether the command is the multiplier, shape (c,).
    """

    joint: IndexArray
    start: IndexArray
    place: IndexArray
    by_multiplier: BoolArray


class RowSet(Protocol):
    """Rows of one kind, evaluated together; c of them, with k entries."""

    @property
    def constraints(self) -> Constraints:
        """Constant part of the rows."""
        ...

    def values(self, model: Model, state: State) -> Array:
        """Return the coordinates s, shape (c,)."""
        ...

    def coefficients(self, model: Model, state: State) -> Array:
        """Return the entries of the rows H, shape (k, 3)."""
        ...


class PassiveRows(RowSet, Protocol):
    """Rows that no joint commands, such as the friction along cables; m of them.

    Their multipliers are in State.extra[PASSIVE_EFFORTS], their memory is in State.extra[ACTUATOR_STATE].
    """

    @property
    def memory_size(self) -> int:
        """How many numbers of memory they have."""
        ...

    def transmissions(self, model: Model, state: State, memory: Array) -> Transmissions:
        """Return the constraints, linearised at a state, with the memory of where the motion began."""
        ...

    def remember(self, model: Model, state: State, memory: Array) -> None:
        """Update the memory (memory_size,) after a motion that ended in a state."""
        ...


class ActuatorGroup(RowSet, Protocol):
    """Actuators of one kind, evaluated together; c of them, with k entries in their rows."""

    @property
    def passive(self) -> PassiveRows | None:
        """Further rows that belong to them; None: there are none."""
        ...

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """Return the constraints at rest under commands (c,), linearised at multipliers (c,)."""
        ...

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """Return the commands (c,) under which they rest at coordinates (c,) with multipliers (c,)."""
        ...

    def keeping(self) -> list[tuple[int, Actuator]]:
        """Return the actuators with internal state, each with its index among the c."""
        ...

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """Return -d(H^T t)/dx at multipliers t (c,), without the part of `surfaces` if `without_surfaces`."""
        ...

    def surfaces(self) -> list[IndexArray]:
        """Return the nodes of the faces of each actuator that presses on faces, shapes (m, a)."""
        ...

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Return the stiffness of these faces at multipliers t (c,); see Actuator.surface_stiffness."""
        ...

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[ActuatorView, ...]:
        """Return the visible state of each actuator."""
        ...


class PlainGroup:
    """Actuators evaluated in NumPy, one after the other."""

    passive: PassiveRows | None = None

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
        """Return the coordinate s of each actuator, shape (c,)."""
        return np.array([each.value(model, state) for each in self._actuators], dtype=float)

    def coefficients(self, model: Model, state: State) -> Array:
        """Return the entries of all rows H = ds/dx, shape (k, 3)."""
        return np.concatenate([np.zeros((0, 3)), *(each.row(model, state) for each in self._actuators)])

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """Return the transmission of each actuator at rest, linearised at its multiplier."""
        table = np.empty((5, len(self._actuators)))
        for c, each in enumerate(self._actuators):
            table[:, c] = each.transmission(float(commands[c]), float(multipliers[c]))
        return Transmissions(*table)

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """Return the command under which each actuator rests at its coordinate and multiplier, shape (c,)."""
        rows = zip(self._actuators, values.tolist(), multipliers.tolist(), strict=True)
        return np.array([each.command_of(s, t) for each, s, t in rows], dtype=float)

    def keeping(self) -> list[tuple[int, Actuator]]:
        """Return the actuators that have internal state, each with its index among the c."""
        return [(c, each) for c, each in enumerate(self._actuators) if each.keeps]

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """Return the joined geometric stiffness of all actuators, or only of those without a surface."""
        return _joined_stiffness(
            [
                each.geometric_stiffness(model, state, float(t))
                for each, t in zip(self._actuators, multipliers, strict=True)
                if each.surface is None or not without_surfaces
            ]
        )

    def surfaces(self) -> list[IndexArray]:
        """Return the node indices of the faces of each actuator that has a surface, shapes (m, a)."""
        return [each.surface for each in self._actuators if each.surface is not None]

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Return the stiffness of each actuator's surface, face by face in [N/m], shapes (m, 3, a, a)."""
        return [
            each.surface_stiffness(state, float(t))
            for each, t in zip(self._actuators, multipliers, strict=True)
            if each.surface is not None
        ]

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[ActuatorView, ...]:
        """Return the view of each actuator, in order."""
        return tuple(
            each.view(model, state, float(t)) for each, t in zip(self._actuators, multipliers, strict=True)
        )


class Actuators:
    """All actuators that constrain a model, group after group, then their passive rows.

    The drives of joints with a frame are not included: their rows are unit vectors, which the step adds to
    its matrix instead; see joint_drive.

    Args:
        groups: Groups of one kind each.

    Attributes:
        groups: The groups.
        constraints: Constant part of all c rows.
        joint: Joint of each actuator, shape (a,); these rows come first.
        multiplied: Joints commanded by a multiplier.
        internal_size: How many numbers of internal state they have in all, in State.extra[ACTUATOR_STATE].
        paced: Joints with a command that drives the coordinate: a multiplier, or the volume of a pump.
    """

    def __init__(self, groups: Sequence[ActuatorGroup] = ()) -> None:
        self.groups = tuple(groups)
        self._passive = [group.passive for group in self.groups if group.passive is not None]
        parts = [rows.constraints for rows in (*self.groups, *self._passive)]
        self._rows = np.concatenate([[0], np.cumsum([len(part.start) - 1 for part in parts])]).astype(int)
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
        self.multiplied: IndexArray = self.joint[self.constraints.by_multiplier[: len(self.joint)]]
        first = self._rows.tolist()
        keeping = [(first[g] + c, each) for g, group in enumerate(self.groups) for c, each in group.keeping()]
        sizes = [each.keeps for _, each in keeping] + [each.memory_size for each in self._passive]
        ends = np.cumsum([0, *sizes]).tolist()
        self.internal_size: int = ends[-1]
        self._keeping = [
            (row, each, slice(*ends[k : k + 2])) for k, (row, each) in enumerate(keeping)
        ]  # row, actuator, its part of the internal state
        self._remembering = [
            (each, slice(*ends[k : k + 2])) for k, each in enumerate(self._passive, start=len(keeping))
        ]  # passive rows, their part of it
        self.paced: IndexArray = np.union1d(self.multiplied, self.joint[[row for row, _ in keeping]])

    def __len__(self) -> int:
        return len(self.constraints.start) - 1

    @property
    def passive_size(self) -> int:
        """Number of passive rows."""
        return len(self) - len(self.joint)

    def spans(self) -> list[tuple[ActuatorGroup, slice, slice]]:
        """Return each group with its rows and its entries among all of them."""
        return [
            (group, rows, entries)
            for group, (rows, entries) in zip(self.groups, self._slices(), strict=False)
        ]

    def passive_spans(self) -> list[tuple[PassiveRows, slice, slice]]:
        """Return each set of passive rows with its rows and its entries among all of them."""
        return [
            (rows, *slices)
            for rows, slices in zip(self._passive, self._slices()[len(self.groups) :], strict=True)
        ]

    def _slices(self) -> list[tuple[slice, slice]]:
        rows, entries = self._rows.tolist(), self._entries.tolist()
        return [
            (slice(*both), slice(*of)) for both, of in zip(pairwise(rows), pairwise(entries), strict=True)
        ]

    def values(self, model: Model, state: State) -> Array:
        """Return the coordinates s of all rows, shape (c,)."""
        every = (*self.groups, *self._passive)
        return np.concatenate([np.zeros(0), *(rows.values(model, state) for rows in every)])

    def rows(self, model: Model, state: State) -> Rows:
        """Return H = ds/dx of all rows on nodes, frames and joints."""
        parts = [rows.coefficients(model, state) for rows in (*self.groups, *self._passive)]
        coefficient = np.concatenate([np.zeros((0, 3)), *parts])
        return Rows(self.constraints.start, self.constraints.place, coefficient)

    def multipliers(self, state: State) -> Array:
        """Return the multipliers t of all rows, shape (c,)."""
        own = state.joint_efforts[self.joint]
        return np.append(own, state.extra[PASSIVE_EFFORTS]) if self._passive else np.asarray(own)

    def set_multipliers(self, state: State, multipliers: Array) -> None:
        """Write the multipliers of all rows (c,) into a state."""
        count = len(self.joint)
        state.joint_efforts[self.joint] = multipliers[:count]
        if self._passive:
            state.extra[PASSIVE_EFFORTS][:] = multipliers[count:]

    def transmissions(self, model: Model, state: State, commands: Array) -> Transmissions:
        """Return all constraints (c,) at rest under commands (a,), linearised at a state."""
        if not self.groups:
            return self._none
        multipliers = state.joint_efforts[self.joint]
        parts = [group.transmissions(commands[rows], multipliers[rows]) for group, rows, _ in self.spans()]
        parts += [
            rows.transmissions(model, state, state.extra[ACTUATOR_STATE][part])
            for rows, part in self._remembering
        ]
        if len(parts) == 1:
            return parts[0]
        return Transmissions(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """Return the commands (a,) under which all rest at coordinates (c,) with multipliers (c,)."""
        parts = [group.commands_of(values[rows], multipliers[rows]) for group, rows, _ in self.spans()]
        return np.concatenate([np.zeros(0), *parts])

    def transmissions_of_step(self, state: State, control: Control, model: Model) -> Transmissions:
        """Return the constraints of all rows in a step: the control's, else those of the targets."""
        if control.transmissions is not None:
            return control.transmissions
        return self.transmissions(model, state, control.targets[self.joint])

    def begin(self, model: Model, state: State, commands: Array) -> Transmissions:
        """Return all constraints of a step of the model from a state, under the commands of joints (j,)."""
        own, span = commands[self.joint], model.dt
        result = self.transmissions(model, state, own)
        for row, actuator, part in self._keeping:
            found = actuator.begin(state, state.extra[ACTUATOR_STATE][part], float(own[row]), span)
            for array, value in zip(result, found, strict=True):
                array[row] = value
        return result

    def end(self, model: Model, state: State, commands: Array) -> None:
        """Update internal state after a step of the model that ended in a state, under commands (j,)."""
        for row, actuator, part in self._keeping:
            command = float(commands[self.joint[row]])
            actuator.end(state, state.extra[ACTUATOR_STATE][part], command, model.dt)
        self._remember(model, state)

    def settle(self, model: Model, state: State, commands: Array) -> None:
        """Set internal state to that of a state at rest under the commands of all joints (j,)."""
        if COMMANDED in state.extra:
            state.extra[COMMANDED][:], state.extra[EFFORT_CHANGE][:] = commands, 0.0
        for row, actuator, part in self._keeping:
            actuator.settle(state, state.extra[ACTUATOR_STATE][part], float(commands[self.joint[row]]))
        self._remember(model, state)

    def _remember(self, model: Model, state: State) -> None:
        for rows, part in self._remembering:
            rows.remember(model, state, state.extra[ACTUATOR_STATE][part])

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """Return -d(H^T t)/dx of all actuators at multipliers t (c,).

        For `without_surfaces` see ActuatorGroup.
        """
        return _joined_stiffness(
            [
                group.geometric_stiffness(model, state, multipliers[rows], without_surfaces)
                for group, rows, _ in self.spans()
            ]
        )

    def surfaces(self) -> list[IndexArray]:
        """Return the nodes of the faces of each actuator that presses on faces, shapes (m, a)."""
        return [each for group in self.groups for each in group.surfaces()]

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Return the stiffness of these faces at multipliers t (c,); see Actuator.surface_stiffness."""
        return [
            each
            for group, rows, _ in self.spans()
            for each in group.surface_stiffness(state, multipliers[rows])
        ]

    def views(self, model: Model, state: State) -> tuple[ActuatorView, ...]:
        """Return the visible state of each actuator, in joint order."""
        multipliers = state.joint_efforts[self.joint]
        views = [
            view for group, rows, _ in self.spans() for view in group.views(model, state, multipliers[rows])
        ]
        return tuple(views[c] for c in np.argsort(self.joint, kind="stable"))

    def measure(self, model: Model, state: State) -> None:
        """Write the actual coordinates s, not the commands, as positions of their joints."""
        if len(self):
            state.joint_positions[self.joint] = self.values(model, state)[: len(self.joint)]

    def report(self, model: Model, state: State, before: Array, multipliers: Array) -> None:
        """Write multipliers (c,), coordinates, and their rates since `before` (c,), one step ago."""
        if len(self):
            self.set_multipliers(state, multipliers)
            self.measure(model, state)
            first = len(state.reduced_velocities) - len(state.joint_positions)
            moved = state.joint_positions[self.joint] - before[: len(self.joint)]
            state.reduced_velocities[first + self.joint] = moved / model.dt


def _joined_stiffness(parts: Sequence[GeometricStiffness]) -> GeometricStiffness:
    if len(parts) < 2:
        return parts[0] if parts else no_geometric_stiffness()
    return GeometricStiffness(
        join_rows([part.rows for part in parts]), np.concatenate([part.weight for part in parts])
    )
