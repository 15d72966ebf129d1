"""How a sensor gets from its description into a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softsim_core.actuation.actuator import ActuatorView
from softsim_core.actuation.building import Surroundings
from softsim_core.arrays import Array
from softsim_core.contact.surfaces import CollisionSurface
from softsim_core.sensing.description import SimulatedSensorDescription
from softsim_core.sensing.place import Place
from softsim_core.sensing.sensor import Sensor


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """What sensors are built into.

    Attributes:
        soft: The model, and how points are bound to its deformable bodies.
        body_names: Names of all bodies, by the numbers that contacts give them.
        places: What moves rigidly, by the names that a scene gives it.
        surfaces: Collision surfaces.
        points: Where their vertices are at the start in [m], shape (v, 3).
        actuators: Every actuator at the start, by the name of its joint.
    """

    soft: Surroundings
    body_names: tuple[str, ...]
    places: Mapping[str, Place]
    surfaces: tuple[CollisionSurface, ...]
    points: Array
    actuators: Mapping[str, ActuatorView]

    def surfaces_of(self, body: str) -> list[CollisionSurface]:
        """The collision surfaces of a body that have triangles."""
        number = self.body_names.index(body)
        return [each for each in self.surfaces if each.owner == number and len(each.triangles)]


@dataclass(frozen=True, slots=True, eq=False)
class SensorKind:
    """A kind of sensor.

    Attributes:
        description: Type of its description.
        build: From a description to a sensor.
    """

    description: type[SimulatedSensorDescription]
    build: Callable[[Any, Scenery], Sensor]

    @property
    def name(self) -> str:
        """The name that scene files use."""
        return self.description.kind


def both(first: object, second: object) -> Array:
    """Two triples, or numbers that stand for three equal ones, one behind the other, shape (6,)."""
    return np.concatenate([np.broadcast_to(np.asarray(each, dtype=float), 3) for each in (first, second)])
