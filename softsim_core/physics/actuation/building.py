"""Construction of actuators from their descriptions, for a model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from softsim_core.base import SHORTENING, Array, IndexArray, JointUnits, SceneError, Vector
from softsim_core.physics.actuation.actuators import Actuator, ActuatorGroup, PlainGroup
from softsim_core.physics.mechanics import Model
from softsim_core.physics.mesh import TetMesh, boundary, closest_point, embed

BESIDE_CELLS: Final = 0.5
"""Largest distance of a point from the body that it is attached to, in mean edges of the cell there."""

NEAR: Final = 1.0
"""Largest distance outside a body, in heights of a cell, of a point that is bound to the nearest body."""


class Gas(NamedTuple):
    """Gas in an actuator: bounds of its gauge pressure, and the absolute pressure around it, in [Pa]."""

    lowest: float
    highest: float
    atmosphere: float


class Route(NamedTuple):
    """The way of an actuator through points of a body, as a cable has it.

    Editors move its points, exporters draw it. Its kind has the keys `points`, `placement` and `pull_point`
    in scene files.

    Attributes:
        body: Name of the deformable body that carries the points.
        points: Returns them in the world in [m], shape (k, 3), at the start; takes the body's mesh, which
            only points that are named there need.
        pull_point: Where it leaves the robot, in the world in [m]; None: at its first point.
        pull_on: Name of the joint that carries that point; None: the world.
        guides: Points that are carried like it and come after it, in the world in [m].
        placed: Whether the points are given in a frame of their own.
        pull_only: Whether it can go slack.
        special: Keys of its kind that are set and change more than the way, such as friction.
        largest_force: Largest tension in [N]; None: not limited.
        rest_length: Length in [m] at coordinate 0; None: that at the start.
    """

    body: str
    points: Callable[[TetMesh | None], Array]
    pull_point: Vector | None = None
    pull_on: str | None = None
    guides: tuple[Vector, ...] = ()
    placed: bool = False
    special: tuple[str, ...] = ()
    pull_only: bool = True
    largest_force: float | None = None
    rest_length: float | None = None


class EditedNumber(NamedTuple):
    """A number in a joint's entry that an editor offers.

    Attributes:
        label: Its name and the unit in which it is shown.
        per_si: Shown units per SI unit.
        keys: Keys to it in the joint's entry in a scene file.
    """

    label: str
    per_si: float
    keys: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorDescription:
    """Description of an actuator in a scene; each kind derives its own, a frozen dataclass.

    Attributes:
        kind: Name of the kind: the joint's `kind`, and the key of the description in scene files.
    """

    kind: ClassVar[str]

    def bodies(self) -> dict[str, str | None]:
        """Return the names of the deformable bodies in its fields, by field."""
        return {}

    @property
    def units(self) -> JointUnits:
        """Units of command, position and effort of its joint."""
        return JointUnits(SHORTENING, SHORTENING, "N")

    @property
    def by_effort(self) -> bool:
        """Whether commands are efforts instead of positions."""
        return False

    @property
    def gas(self) -> Gas | None:
        """The gas in it; None: there is none."""
        return None

    @property
    def route(self) -> Route | None:
        """Its way through points of a body; None: it has none."""
        return None

    @property
    def edited_numbers(self) -> tuple[EditedNumber, ...]:
        """The numbers of its joint that an editor offers."""
        return ()

    def enclosed_nodes(self, joint: str, mesh: TetMesh) -> IndexArray | None:
        """Return the nodes of its body's mesh around the hollow that it fills; None: it fills none.

        Args:
            joint: Name of its joint, for messages.
            mesh: Mesh of its body.

        Raises:
            SceneError: the mesh has no such hollow.
        """
        return None

    def carriers(self) -> dict[str, str | None]:
        """Return the names of joints that carry a part of it, by field."""
        return {}

    def carried_by(self, joint: str) -> ActuatorDescription:
        """Return the description with its parts that are fixed in space moved onto a joint."""
        return self


class Points(NamedTuple):
    """Points that a deformable body carries.

    Attributes:
        nodes: Nodes of the model that carry each point, shape (k, 4).
        weights: Weights of these nodes, rows add up to 1, shape (k, 4).
    """

    nodes: IndexArray
    weights: Array


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Model and meshes for which actuators are built.

    Attributes:
        model: The model.
        meshes: Tetrahedra of each deformable body in the body's own node numbers.
        first_node: Number in the model of the first node of each body.
    """

    model: Model
    meshes: Mapping[str, TetMesh]
    first_node: Mapping[str, int]

    def joint(self, name: str) -> int:
        """Return the index of a joint."""
        return [joint.name for joint in self.model.joints].index(name)

    def bind(self, owner: str, body: str, points: Array) -> Points:
        """Return the nodes that carry points (k, 3) in [m], at the start, of the actuator called `owner`.

        A point outside the body, by up to `BESIDE_CELLS` of the cell at the nearest point of its surface, is
        attached to that cell at its distance; a warning reports how far outside it is.

        Raises:
            SceneError: a point is farther outside the body.
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
        """Return the nodes that carry a point (3,) in [m], at the start, in or on any body, or None.

        A point that is farther outside every body than NEAR heights of a cell is on none. A point that is
        closer keeps its distance from the body.
        """
        found = [(embed(point[None], mesh), self.first_node[body]) for body, mesh in self.meshes.items()]
        on, start = min(found, key=lambda each: float(each[0].outside[0]), default=(None, 0))
        if on is None or on.outside[0] > NEAR:
            return None
        return Points(on.nodes + start, on.weights)


class Placed(NamedTuple):
    """Actuator to build: name and index of its joint, and its description."""

    name: str
    joint: int
    description: Any


@dataclass(frozen=True, slots=True, eq=False)
class ActuatorKind:
    """A kind of actuator.

    Attributes:
        name: The name that joints and scene files use.
        description: Type of its description; None: a joint without description (revolute, prismatic).
        build: Builds all actuators of this kind in a scene, as a group.
    """

    name: str
    description: type[ActuatorDescription] | None
    build: Callable[[Sequence[Placed], Surroundings], ActuatorGroup]


def plain_kind(
    description: type[ActuatorDescription], build: Callable[[Placed, Surroundings], Actuator]
) -> ActuatorKind:
    """Return a kind whose actuators are built one by one and evaluated in NumPy."""

    def build_all(placed: Sequence[Placed], surroundings: Surroundings) -> ActuatorGroup:
        return PlainGroup([build(each, surroundings) for each in placed])

    return ActuatorKind(description.kind, description, build_all)
