"""Cables: frictionless lines through points that a body carries, pulled at one end.

The length L is the sum of the straight segments; the coordinate s = L0 - L, the cable displacement, is how
much shorter the cable is than at rest. Its row is H = ds/dx = -dL/dx: at a point the unit vectors towards
both neighbours, so one tension acts in all segments. A cable that only pulls keeps s >= the commanded
displacement with a tension >= 0 that is zero where it is slack.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.actuation.actuator import ActuatorView, GeometricStiffness
from softsim_core.actuation.actuators import Constraints
from softsim_core.actuation.cable.layout import RowLayout
from softsim_core.actuation.compiled.cables import IN_BODY, IN_WORLD, CableArrays
from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows
from softsim_core.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False)
class CableView(ActuatorView):
    """What one can see of a cable; its points begin with the pull point where there is one.

    Attributes:
        length: In [m].
    """

    length: float = 0.0

    @property
    def tension(self) -> float:
        """In [N]."""
        return self.multiplier


@dataclass(frozen=True, slots=True, eq=False)
class Cables:
    """All cables of a scene; their points one behind the other, a pull point first where there is one.

    Attributes:
        names: Names of the joints that pull them.
        joint: Indices of these joints, shape (c,).
        first: Where each cable's points begin; the last one ends them, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and their weights, shapes (p, 4); pull points have zeros.
        pull: Pull points: number of the point, joint that carries it (or -1), and where in its frame in [m].
        rest_length: Lengths in [m] at displacement 0, shape (c,).
        lower, upper: Bounds of the tensions in [N], shape (c,).
        by_force: Whether the command is a tension in [N] instead of a displacement in [m], shape (c,).
        layout: What never changes in their rows.
        any_by_force: Whether one is commanded by a tension.
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
    any_by_force: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "any_by_force", bool(self.by_force.any()))

    @property
    def constraints(self) -> Constraints:
        """See ActuatorGroup."""
        layout, none = self.layout, np.zeros(len(self.names))
        return Constraints(self.joint, layout.start, layout.place, none, self.by_force)

    def values(self, model: Model, state: State) -> Array:
        """Displacements in [m], shape (c,)."""
        return np.asarray(self.rest_length - self.lengths(self.points(model, state)))

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """Bounds of the tensions in [N], shapes (c,), under the commands of the cables (c,)."""
        if not self.any_by_force:
            return self.lower, self.upper
        wanted = np.clip(commands, self.lower, self.upper)
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
        """Length of each cable in [m], shape (c,), with its points at (p, 3)."""
        return np.asarray(np.add.reduceat(self.directions(points)[1], self.first[:-1]))

    def pulls(self, points: Array) -> Array:
        """H on the points, shape (p, 3): the force on each per unit of tension."""
        unit, _ = self.directions(points)
        pulls = np.zeros_like(points)
        pulls[:-1] = unit
        pulls[1:] -= unit
        return pulls

    def coefficients(self, model: Model, state: State) -> Array:
        """Entries of the rows, shape (k, 3)."""
        layout, points = self.layout, self.points(model, state)
        pulls, coefficient = self.pulls(points), np.zeros((len(self.layout.place), 3))
        coefficient[layout.of_points] = (self.weights[:, :, None] * pulls[:, None, :]).reshape(-1, 3)
        if len(layout.levers):
            moved = self._moved(model, state, points)
            coefficient[layout.levers, 0] = np.einsum("mi,mi->m", pulls[layout.lever_points], moved)
        return coefficient

    def _moved(self, model: Model, state: State, points: Array) -> Array:
        """Velocity of pull points per unit velocity of each joint that carries them, shape (m, 3)."""
        motion_subspace, k, at = (
            model.motion_subspace(state),
            self.layout.lever_unknowns,
            self.layout.lever_points,
        )
        return (
            np.cross(motion_subspace.angular[k], points[at] - motion_subspace.origin[k])
            + motion_subspace.linear[k]
        )

    def geometric_stiffness(self, model: Model, state: State, multipliers: Array) -> GeometricStiffness:
        """Two rows across each segment under tension, and what turns pull points with their joints.

        A segment of length l under tension t resists turning with the stiffness t / l across itself. A pull
        point p on a revolute joint of angle q adds -t H d2p/dq2 to the joint.
        """
        points = self.points(model, state)
        unit, length = self.directions(points)
        index: list[IndexArray] = []
        coefficient: list[Array] = []
        sizes: list[int] = []
        weight: list[float] = []
        moved = self._moved(model, state, points)
        for c in range(len(self.names)):
            if multipliers[c] == 0.0:
                continue
            for p in range(self.first[c], self.first[c + 1] - 1):
                for across in _across(unit[p]):
                    size = 0
                    for point, sign in ((p + 1, 1.0), (p, -1.0)):
                        places, motion = self._motion(model, point, sign * across, moved)
                        index.append(places)
                        coefficient.append(motion)
                        size += len(places)
                    sizes.append(size)
                    weight.append(float(multipliers[c] / length[p]))
            for place, turning in self._turning(model, state, points, c):
                index.append(np.array([place]))
                coefficient.append(np.array([[1.0, 0.0, 0.0]]))
                sizes.append(1)
                weight.append(float(multipliers[c] * turning))
        rows = Rows(
            np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes, dtype=np.int64)]),
            np.concatenate([np.zeros(0, np.int64), *index]),
            np.concatenate([np.zeros((0, 3)), *coefficient]),
        )
        return GeometricStiffness(rows, np.array(weight, dtype=float))

    def _motion(self, model: Model, point: int, along: Array, moved: Array) -> tuple[IndexArray, Array]:
        """How far a point goes `along` (3,) with what carries it: places (k,) and coefficients (k, 3)."""
        if self.weights[point].any():
            return self.nodes[point], self.weights[point][:, None] * along
        own = np.flatnonzero(self.layout.lever_points == point)
        coefficient = np.zeros((len(own), 3))
        coefficient[:, 0] = moved[own] @ along
        return len(model.rest) + self.layout.lever_unknowns[own], coefficient

    def _turning(self, model: Model, state: State, points: Array, c: int) -> list[tuple[int, float]]:
        """Joints that turn the pull point of cable c, and -H d2p/dq2 per unit of tension."""
        result, pulls, motion_subspace = [], self.pulls(points), model.motion_subspace(state)
        for unknown, point in zip(self.layout.lever_unknowns, self.layout.lever_points, strict=True):
            axis = motion_subspace.angular[unknown]
            if self.first[c] <= point < self.first[c + 1] and axis.any():
                away = np.cross(axis, np.cross(axis, points[point] - motion_subspace.origin[unknown]))
                result.append((len(model.rest) + int(unknown), -float(pulls[point] @ away)))
        return [each for each in result if each[1] != 0.0]

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[CableView, ...]:
        """What one can see of each cable at tensions (c,) in [N]."""
        points = self.points(model, state)
        lengths, outside = self.lengths(points), {point for point, _, _ in self.pull}
        return tuple(
            CableView(
                name=name,
                kind="cable",
                points=points[self.first[c] : self.first[c + 1]],
                value=float(self.rest_length[c] - lengths[c]),
                multiplier=float(multipliers[c]),
                pulled_from_outside=int(self.first[c]) in outside,
                length=float(lengths[c]),
            )
            for c, name in enumerate(self.names)
        )

    def compiled(self) -> CableArrays:
        """The cables for the compiled kernels."""
        layout, points = self.layout, len(self.nodes)
        carrier, local = np.full(points, IN_BODY), np.zeros((points, 3))
        for point, joint, place in self.pull:
            carrier[point], local[point] = (joint if joint >= 0 else IN_WORLD), place
        return CableArrays(
            first=self.first,
            nodes=self.nodes,
            weights=self.weights,
            carrier=carrier,
            local=local,
            entry=layout.of_points[::4].copy(),
            levers=layout.levers,
            lever_points=layout.lever_points,
            lever_unknowns=layout.lever_unknowns,
            rest_length=self.rest_length,
            points=np.zeros((points, 3)),
            pulls=np.zeros((points, 3)),
        )


def _across(unit: Array) -> tuple[Array, Array]:
    """Two unit vectors across a unit vector, each (3,)."""
    aside = np.zeros(3)
    aside[int(np.argmin(np.abs(unit)))] = 1.0
    first = np.cross(unit, aside)
    first /= np.linalg.norm(first)
    return first, np.cross(unit, first)
