"""How an actuator gets from its description into a model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from softsim_core.base import SHORTENING, Array, IndexArray, JointUnits, SceneError
from softsim_core.physics.actuation.actuators import Actuator, ActuatorGroup, PlainGroup
from softsim_core.physics.mechanics import Model
from softsim_core.physics.mesh import TetMesh, boundary, closest_point, embed

BESIDE_CELLS: Final = 0.5
"""Farthest distance of a point from the body that it is attached to, in mean edges of the cell there."""

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
        """Return the nodes that carry points (k, 3) in [m], at the start, of the actuator called `owner`.

        A point beside the body, by up to `BESIDE_CELLS` of the cell at the nearest place of its surface,
        follows that cell and stays where it is; a warning says how far outside it is.

        Raises:
            SceneError: a point lies farther outside the body.
        """
        mesh = self.meshes[body]
        bound = embed(points, mesh)
        nodes, weights = bound.nodes.copy(), bound.weights.copy()
        for number in np.flatnonzero(bound.outside > mesh.around).tolist():
            point = points[number]
            place = closest_point(point, mesh.points[boundary(mesh)])
            distance = float(np.linalg.norm(point - place))
            near = embed(place[None], mesh)
            nodes[number] = near.nodes[0]
            cell = mesh.points[mesh.tets[near.tets[0] // (8 if mesh.order == 2 else 1), :4]]
            size = float(np.mean([np.linalg.norm(a - b) for a, b in combinations(cell, 2)]))
            where = (
                f"{owner}: point {number} at {point.round(6).tolist()} m lies outside body {body}, "
                f"{1e3 * distance:.3g} mm from the nearest place of its surface, {place.round(6).tolist()} m"
            )
            if distance > BESIDE_CELLS * size:
                raise SceneError(
                    f"{where}; allowed is half a cell, {1e3 * BESIDE_CELLS * size:.3g} mm: move it inside, "
                    "or check its placement and units"
                )
            warnings.warn(f"{where}; it is attached to the cell there", stacklevel=2)
            corners = mesh.points[nodes[number]]
            edges = (corners[1:] - corners[0]).T
            local = np.linalg.solve(edges, point - corners[0])
            weights[number] = 1.0 - local.sum(), *local
        return Points(nodes + self.first_node[body], weights)

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
