"""What sensors sit on: frames of a robot, and places in or on its deformable bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import SceneError, listing
from softsim_core.identification.description import EFFECTOR, SensorDescription
from softsim_core.mechanics.pose import nearest_rotation, rotation_of
from softsim_core.mesh.embedding import embed
from softsim_core.simulation import Simulation
from softsim_core.wrong_names import known_names

OUTSIDE = 0.05
"""A place farther outside its body than this part of an element lies beside it."""

FEWEST = 4
"""So many nodes say how a body turns at a place."""


@dataclass(frozen=True, slots=True, eq=False)
class _BodyPlace:
    """A place that follows four nodes, and turns with the nodes around it; all are numbers of all nodes."""

    nodes: IndexArray
    weights: Array
    around: IndexArray
    centred: Array

    def seen(self, positions: Array) -> tuple[Array, Array]:
        """Where it is, and how far it is turned from rest."""
        moved = positions[self.around]
        return self.weights @ positions[self.nodes], nearest_rotation(
            self.centred, moved - moved.mean(axis=0)
        )


class Places:
    """What the sensors of a session sit on, in a simulation.

    Args:
        simulation: Any of the scene, at rest or not.
        sensors: The sensors, s of them.

    Raises:
        SceneError: the scene has no such frame, or no body at a place.
    """

    def __init__(self, simulation: Simulation, sensors: Sequence[SensorDescription]) -> None:
        self._places: list[str | _BodyPlace] = [_place(simulation, sensor) for sensor in sensors]

    def seen(self, simulation: Simulation) -> tuple[Array, Array]:
        """Positions in [m], shape (s, 3), and rotations (s, 3, 3), as the simulation is now."""
        positions, frames = simulation.positions, simulation.frames()
        found = []
        for place in self._places:
            if isinstance(place, str):
                pose = frames[place]
                found.append((pose.position, rotation_of(pose.quaternion_xyzw)))
            else:
                found.append(place.seen(positions))
        return np.array([each for each, _ in found]), np.array([turn for _, turn in found])


def _place(simulation: Simulation, sensor: SensorDescription) -> str | _BodyPlace:
    if sensor.place is not None:
        return _on_body(simulation, sensor)
    scene, known = simulation.scene, simulation.frames()
    name = sensor.at
    if name == EFFECTOR:
        if scene.effector is None:
            raise SceneError(
                f"sensor {sensor.name}: scene {scene.name} has no effector; say what it sits on: "
                f"at (one of {listing(known)}), or place (a point of a body)"
            )
        name = scene.effector
    if name not in known:
        raise SceneError(
            f"sensor {sensor.name}: no frame {name!r} in {scene.name}; {known_names(name, known, 'it has')}"
        )
    return name


def _on_body(simulation: Simulation, sensor: SensorDescription) -> _BodyPlace:
    point, rest = np.array(sensor.place), simulation.model.rest
    best: tuple[float, _BodyPlace] | None = None
    for body in simulation.bodies:
        found, own = embed(point[None], body.solid), rest[body.nodes]
        if best is None or found.outside[0] < best[0]:
            far = np.linalg.norm(own - point, axis=1)
            near = np.flatnonzero(far <= sensor.patch)
            if len(near) < FEWEST:
                near = np.argsort(far)[:FEWEST]
            centred = own[near] - own[near].mean(axis=0)
            nodes = found.nodes[0] + body.nodes.start
            best = (
                float(found.outside[0]),
                _BodyPlace(nodes, found.weights[0], near + body.nodes.start, centred),
            )
    if best is None or best[0] > OUTSIDE:
        raise SceneError(
            f"sensor {sensor.name}: no body of {simulation.scene.name} is at {point.tolist()} m; give the "
            "place on the body, and the way from there to the sensor as its offset"
        )
    return best[1]
