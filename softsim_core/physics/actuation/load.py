"""Loads on a body as actuators: a force at a point, a moment around it, or an acceleration of the whole body.

A load's direction is fixed in space: it does not turn with the body. Its command is its multiplier t. With
the direction d, node masses m_a, and arms r_a of the nodes around a point from their mean, the rows H are

    force:         w_a d                          w_a: weights of the nodes that carry the point
    acceleration:  m_a d
    moment:        (J^-1 d) x r_a                 J = sum over a of |r_a|^2 I - r_a r_a^T

The forces H^T t of a moment have no resultant force, and their resultant moment is t d in any state. A moment
that stays in space has no potential, so its exact tangent is not symmetric; the symmetric part is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import (
    ANGLE,
    DIRECTION,
    FORCE,
    LENGTH,
    POINT,
    Array,
    JointUnits,
    SceneError,
    Unit,
    Vector,
    need_finite,
    need_positive,
    need_unit,
)
from softsim_core.physics.actuation.actuators import Actuator, GeometricStiffness, no_geometric_stiffness
from softsim_core.physics.actuation.building import ActuatorDescription, Placed, Surroundings, plain_kind
from softsim_core.physics.mechanics import Model, Rows, State, cross_matrices, nearest_rotation, rotation_log

MOMENT = Unit("N m", "N m", 1.0, 0.001, 1.0)
ACCELERATION = Unit("m/s^2", "m/s^2", 1.0, 0.01, 20.0)
FIRST_MOMENT = Unit("kg m", "kg m", 1.0, 0.001, 1.0)
_UNITS = {
    "force": JointUnits(FORCE, LENGTH, "N"),
    "moment": JointUnits(MOMENT, ANGLE, "N m"),
    "acceleration": JointUnits(ACCELERATION, FIRST_MOMENT, "m/s^2"),
}

NEGLIGIBLE = 1e-9
"""Share of the largest eigenvalue below which one of a geometric stiffness counts as zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadDescription(ActuatorDescription):
    """Load that a joint of kind "load" puts on a body, with a direction fixed in space.

    Exactly one of `force`, `moment` and `acceleration` gives its direction. The joint's command is its size
    in [N], [N m] or [m/s^2]. Its position is what it does work on: the way of the point in [m], the rotation
    of the body there in [rad], or the displacement of the body times its mass in [kg m].

    Attributes:
        body: Name of the deformable body.
        point: Where a force or a moment acts, in [m], at the start of the scene.
        force: Unit vector of a force.
        moment: Unit vector of a moment.
        acceleration: Unit vector of a load on each node of `body` in proportion to its mass, as gravity is.
        patch: Radius in [m]: a moment acts on the nodes within it around `point`.
    """

    kind: ClassVar[str] = "load"
    body: str
    point: Vector | None = field(default=None, metadata=POINT)
    force: Vector | None = field(default=None, metadata=DIRECTION)
    moment: Vector | None = field(default=None, metadata=DIRECTION)
    acceleration: Vector | None = field(default=None, metadata=DIRECTION)
    patch: float = 0.01

    def __post_init__(self) -> None:
        if sum(getattr(self, name) is not None for name in _UNITS) != 1:
            raise SceneError("load: give exactly one of force, moment and acceleration")
        need_unit("load", self.quantity, self.direction)
        if (self.point is None) != (self.quantity == "acceleration"):
            raise SceneError("load: force and moment need a point; acceleration acts on the whole body")
        if self.point is not None:
            need_finite("load", "point", self.point)
        need_positive("load", "patch", self.patch, "m")

    @property
    def quantity(self) -> str:
        """Which of its fields gives its direction."""
        return next(name for name in _UNITS if getattr(self, name) is not None)

    @property
    def direction(self) -> Vector:
        """Its unit vector."""
        direction: Vector = getattr(self, self.quantity)
        return direction

    @property
    def units(self) -> JointUnits:
        """Units of its joint."""
        return _UNITS[self.quantity]

    @property
    def by_effort(self) -> bool:
        """Whether commands are efforts: they are."""
        return True

    def bodies(self) -> dict[str, str | None]:
        """Return the name of its body."""
        return {"body": self.body}


class LinearLoad(Actuator):
    """A load whose row is constant: a force, or an acceleration, with a weight of each node."""

    kind = "load"

    def __init__(self, placed: Placed, surroundings: Surroundings) -> None:
        load, model = placed.description, surroundings.model
        if load.point is None:
            nodes = np.arange(len(surroundings.meshes[load.body].points)) + surroundings.first_node[load.body]
            weights = model.mass[nodes]
        else:
            bound = surroundings.bind(f"load {placed.name}", load.body, np.array([load.point]))
            nodes, weights = bound.nodes[0], bound.weights[0]
        super().__init__(placed.name, placed.joint, nodes, by_multiplier=True)
        self._row = np.outer(weights, load.direction)
        self._start = float((self._row * model.rest[nodes]).sum())

    def value(self, model: Model, state: State) -> float:
        """Return the weighted displacement along its direction."""
        return float((self._row * state.positions[self.place]).sum()) - self._start

    def row(self, model: Model, state: State) -> Array:
        """Return the weights times the direction, shape (k, 3)."""
        return self._row


class MomentLoad(Actuator):
    """A moment on the nodes around a point."""

    kind = "load"

    def __init__(self, placed: Placed, surroundings: Surroundings) -> None:
        load, model = placed.description, surroundings.model
        first, count = surroundings.first_node[load.body], len(surroundings.meshes[load.body].points)
        places = model.rest[first : first + count]
        near = np.flatnonzero(np.linalg.norm(places - load.point, axis=1) <= load.patch)
        self._at_rest = places[near] - places[near].mean(axis=0) if len(near) else places[near]
        if np.linalg.matrix_rank(self._at_rest, tol=NEGLIGIBLE) < 2:
            raise SceneError(
                f"load {placed.name}: the {len(near)} nodes of {load.body} within {load.patch:g} m of "
                f"{list(load.point)} m are on a line; increase patch"
            )
        super().__init__(placed.name, placed.joint, near + first, by_multiplier=True)
        self._direction = np.array(load.direction)

    def _arms(self, state: State) -> tuple[Array, Array]:
        """Return the arms of the nodes (k, 3) and J (3, 3)."""
        places = state.positions[self.place]
        arms = places - places.mean(axis=0)
        return arms, (arms**2).sum() * np.eye(3) - arms.T @ arms

    def value(self, model: Model, state: State) -> float:
        """Return the component along its direction of the rotation vector of the nodes from rest in [rad]."""
        arms = self._arms(state)[0]
        if not np.isfinite(arms).all():  # of an iteration that diverged, which the solver refuses
            return math.nan
        turn = rotation_log(nearest_rotation(self._at_rest, arms))
        return float(turn @ self._direction)

    def row(self, model: Model, state: State) -> Array:
        """Return the forces of a unit moment, shape (k, 3)."""
        arms, inertia = self._arms(state)
        return np.cross(np.linalg.solve(inertia, self._direction), arms)

    def geometric_stiffness(self, model: Model, state: State, multiplier: float) -> GeometricStiffness:
        """Return the symmetric part of -d(H^T t)/dx."""
        arms, inertia = self._arms(state)
        if multiplier == 0.0 or not np.isfinite(inertia).all():
            return no_geometric_stiffness()
        count, inverse = len(arms), np.linalg.inv(inertia)
        spin = inverse @ (multiplier * self._direction)
        # of J spin = t d: dspin = -J^-1 dJ spin, with dJ spin = sum (2 r.dr) spin - dr (r.spin) - r (dr.spin)
        change = 2.0 * spin[None, :, None] * arms[:, None] - (arms @ spin)[:, None, None] * np.eye(3)
        change -= arms[:, :, None] * spin
        turns = -inverse @ change
        slope = np.einsum("aij,bjk->aibk", -cross_matrices(arms), turns)
        own = np.eye(count)[:, None, :, None] * cross_matrices(spin)[None, :, None, :]
        slope = (slope + own).reshape(3 * count, 3 * count)
        mean = np.eye(3 * count) - np.kron(np.full((count, count), 1.0 / count), np.eye(3))
        values, vectors = np.linalg.eigh(-0.5 * mean @ (slope + slope.T) @ mean)
        chosen = np.abs(values) > NEGLIGIBLE * np.abs(values).max(initial=0.0)
        height = int(chosen.sum())
        coefficient = vectors[:, chosen].T.reshape(-1, 3)
        rows = Rows(count * np.arange(height + 1), np.tile(self.place, height), coefficient)
        return GeometricStiffness(rows, values[chosen])


def _build(placed: Placed, surroundings: Surroundings) -> Actuator:
    moment = placed.description.moment is not None
    return MomentLoad(placed, surroundings) if moment else LinearLoad(placed, surroundings)


LOAD = plain_kind(LoadDescription, _build)
