"""Cables: frictionless lines through points that a body carries, pulled at one end.

The length L is the sum of the straight segments; the travel s = L0 - L is how much shorter the cable is than
at rest. Its row is H = ds/dx = -dL/dx: at a point the unit vectors towards both neighbours, so one tension
acts in all segments. A cable that only pulls keeps s >= the commanded travel with a tension >= 0 that is zero
where it is slack.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.actuation.cable_layout import RowLayout
from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.dynamics.rows import Rows
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False)
class CableView:
    """What one can see of a cable.

    Attributes:
        name: Name of the joint that pulls it.
        points: Its points in [m], a pull point first where there is one, shape (k, 3).
        pulled_from_outside: Whether the first point is a pull point.
        length: In [m].
        tension: In [N].
    """

    name: str
    points: Array
    pulled_from_outside: bool
    length: float
    tension: float


@dataclass(frozen=True, slots=True, eq=False)
class Cables:
    """All cables of a scene; their points one behind the other, a pull point first where there is one.

    Attributes:
        names: Names of the joints that pull them.
        joint: Indices of these joints, shape (c,).
        first: Where each cable's points begin; the last one ends them, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and their weights, shapes (p, 4); pull points have zeros.
        pull: Pull points: number of the point, joint that carries it (or -1), and where in its frame in [m].
        rest_length: Lengths in [m] at travel 0, shape (c,).
        lower, upper: Bounds of the tensions in [N], shape (c,).
        by_force: Whether the command is a tension in [N] instead of a travel in [m], shape (c,).
        layout: What never changes in their rows.
        forced: Joints commanded by a tension.
    """

    names: tuple[str, ...]
    joint: IndexArray
    first: IndexArray
    nodes: IndexArray
    weights: Array
    pull: tuple[tuple[int, int, Array], ...]
    rest_length: Array
    lower: Array
    upper: Array
    by_force: BoolArray
    layout: RowLayout
    forced: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "forced", tuple(self.joint[self.by_force].tolist()))

    def __len__(self) -> int:
        return len(self.names)

    def travels(self, commands: Array, state: State) -> Array:
        """Where all joints go (j,) in [rad] or [m]: one whose command is a tension keeps its travel."""
        if not self.forced:
            return commands
        positions = commands.copy()
        positions[list(self.forced)] = state.joint_positions[list(self.forced)]
        return positions

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """Bounds of the tensions in [N], shapes (c,), for the commands of all joints (j,)."""
        if not self.forced:
            return self.lower, self.upper
        wanted = np.clip(commands[self.joint], self.lower, self.upper)
        return np.where(self.by_force, wanted, self.lower), np.where(self.by_force, wanted, self.upper)

    def points(self, model: Model, state: State) -> Array:
        """All points in [m], shape (p, 3)."""
        points = np.asarray(np.einsum("pk,pki->pi", self.weights, state.positions[self.nodes]))
        frames: dict[int, tuple[Array, Array]] = {}
        for point, joint, local in self.pull:
            if joint >= 0 and joint not in frames:
                frames[joint] = model.joint_frame(joint, state)
            points[point] = frames[joint][0] + frames[joint][1] @ local if joint >= 0 else local
        return points

    def directions(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors and lengths in [m] of the segments behind each point; 0 between cables."""
        along = points[1:] - points[:-1]
        along[self.first[1:-1] - 1] = 0.0
        length = np.sqrt(np.einsum("pi,pi->p", along, along))
        return along / np.maximum(length, 1e-12)[:, None], length

    def lengths(self, points: Array) -> Array:
        """Length of each cable in [m], shape (c,)."""
        return self.pulls(points)[1]

    def pulls(self, points: Array) -> tuple[Array, Array]:
        """H on the points, shape (p, 3): the force on each a unit of tension; lengths (c,) in [m]."""
        unit, length = self.directions(points)
        pulls = np.zeros_like(points)
        pulls[:-1] = unit
        pulls[1:] -= unit
        return pulls, np.asarray(np.add.reduceat(length, self.first[:-1]))

    def rows(self, model: Model, state: State, points: Array, pulls: Array) -> Rows:
        """The cables' rows; a commanded travel enters as -1 on its joint, so that a row is s - travel."""
        layout = self.layout
        coefficient = layout.coefficient.copy()
        coefficient[layout.of_points] = (self.weights[:, :, None] * pulls[:, None, :]).reshape(-1, 3)
        if len(layout.levers):
            screws, k, at = model.screws(state), layout.lever_unknowns, layout.lever_points
            moved = np.cross(screws.angular[k], points[at] - screws.origin[k]) + screws.linear[k]
            coefficient[layout.levers, 0] = np.einsum("mi,mi->m", pulls[at], moved)
        return Rows(layout.start, layout.place, coefficient)

    def views(self, model: Model, state: State) -> tuple[CableView, ...]:
        """What one can see of each cable."""
        points = self.points(model, state)
        lengths, outside = self.lengths(points), {point for point, _, _ in self.pull}
        return tuple(
            CableView(
                name,
                points[self.first[c] : self.first[c + 1]],
                int(self.first[c]) in outside,
                float(lengths[c]),
                float(state.joint_efforts[self.joint[c]]),
            )
            for c, name in enumerate(self.names)
        )

    def report(self, model: Model, state: State, tensions: Array) -> None:
        """Write tensions (c,) [N] as joint efforts, and the travel of cables commanded by force."""
        state.joint_efforts[self.joint] = tensions
        if self.forced:
            travel = self.rest_length - self.lengths(self.points(model, state))
            state.joint_positions[self.joint[self.by_force]] = travel[self.by_force]

    def gaps(self, state: State, lengths: Array) -> Array:
        """Travel beyond the commanded one in [m], s - q, of cables of these lengths (c,) [m], shape (c,)."""
        return np.asarray(self.rest_length - lengths - state.joint_positions[self.joint])


def no_cables() -> Cables:
    """The cables of a scene without any."""
    none, index = np.zeros(0), np.zeros(0, np.int64)
    layout = RowLayout(np.zeros(1, np.int64), index, np.zeros((0, 3)), *(index,) * 4)
    points, weights = np.zeros((0, 4), np.int64), np.zeros((0, 4))
    first, by_force = np.zeros(1, np.int64), np.zeros(0, np.bool_)
    return Cables((), index, first, points, weights, (), none, none, none, by_force, layout)
