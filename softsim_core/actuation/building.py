"""How an actuator gets from its description into a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from softsim_core.actuation.actuator import Actuator
from softsim_core.actuation.actuators import ActuatorGroup, PlainGroup
from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import SceneError
from softsim_core.mechanics.model import Model
from softsim_core.mesh import TetMesh, embed
from softsim_core.units import SHORTENING, JointUnits

NEAR: Final = 1.0
"""So far outside a body, in heights of a cell, a point may lie that is bound to the nearest one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorDescription:
    """What a scene says of an actuator; each kind derives its own, a frozen dataclass.

    Attributes:
        kind: Name of the kind: the joint's `kind`, and the key of the description in scene files.
    """

    kind: ClassVar[str]

    def bodies(self) -> dict[str, str | None]:
        """Names of the deformable bodies that fields name, by field."""
        return {}

    @property
    def units(self) -> JointUnits:
        """What command, position and effort of its joint are told in."""
        return JointUnits(SHORTENING, SHORTENING, "N")

    @property
    def by_effort(self) -> bool:
        """Whether commands are what it acts with, not where its joint shall be."""
        return False

    def carriers(self) -> dict[str, str | None]:
        """Names of joints that fields name as what carries something, by field."""
        return {}

    def carried_by(self, joint: str) -> ActuatorDescription:
        """The same on something that a joint carries: what stands in space moves with the joint instead."""
        return self


class Points(NamedTuple):
    """Points that a deformable body carries.

    Attributes:
        nodes: Nodes of the model that carry each point, shape (k, 4).
        weights: Their weights, rows add up to 1, shape (k, 4).
    """

    nodes: IndexArray
    weights: Array


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What actuators are built into.

    Attributes:
        model: The model.
        meshes: Tetrahedra of each deformable body in its own node numbers.
        first_node: Number in the model of the first node of each body.
    """

    model: Model
    meshes: Mapping[str, TetMesh]
    first_node: Mapping[str, int]

    def joint(self, name: str) -> int:
        """Index of a joint."""
        return [joint.name for joint in self.model.joints].index(name)

    def bind(self, owner: str, body: str, points: Array) -> Points:
        """The nodes that carry points (k, 3) in [m], at the start, of the actuator called `owner`.

        Raises:
            SceneError: a point lies outside the body.
        """
        mesh = self.meshes[body]
        bound = embed(points, mesh)
        worst = int(np.argmax(bound.outside))
        if bound.outside[worst] > mesh.around:
            raise SceneError(
                f"{owner}: point {worst} at {points[worst].round(6).tolist()} m lies outside body "
                f"{body}; move it inside, or check its placement"
            )
        return Points(bound.nodes + self.first_node[body], bound.weights)

    def bind_near(self, point: Array) -> Points | None:
        """The nodes that carry a point (3,) in [m], at the start, in or on any body; None: none is there.

        Farther outside every body than NEAR heights of a cell it is on none; others stand off it.
        """
        found = [(embed(point[None], mesh), self.first_node[body]) for body, mesh in self.meshes.items()]
        on, start = min(found, key=lambda each: float(each[0].outside[0]), default=(None, 0))
        if on is None or on.outside[0] > NEAR:
            return None
        return Points(on.nodes + start, on.weights)


class Placed(NamedTuple):
    """An actuator to build: name and index of its joint, and its description."""

    name: str
    joint: int
    description: Any


@dataclass(frozen=True, slots=True, eq=False)
class ActuatorKind:
    """A kind of actuator.

    Attributes:
        name: The name that joints and scene files use.
        description: Type of its description; None: a joint without description (revolute, prismatic).
        build: All actuators of this kind in a scene, as a group.
    """

    name: str
    description: type[ActuatorDescription] | None
    build: Callable[[Sequence[Placed], Surroundings], ActuatorGroup]


def plain_kind(
    description: type[ActuatorDescription], build: Callable[[Placed, Surroundings], Actuator]
) -> ActuatorKind:
    """A kind whose actuators are built one by one and evaluated in NumPy."""

    def build_all(placed: Sequence[Placed], surroundings: Surroundings) -> ActuatorGroup:
        return PlainGroup([build(each, surroundings) for each in placed])

    return ActuatorKind(description.kind, description, build_all)
