"""The resultant of all contacts on a body: a force and a moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softsim_core.base import Array, Vector
from softsim_core.physics.mechanics import cross
from softsim_core.physics.sensing.description import (
    ANY_BODY,
    PLACE,
    Quantity,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
    both,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchSensorDescription(SimulatedSensorDescription):
    """The resultant of the contact forces on a body: force in [N] and moment in [N m].

    Attributes:
        body: The body, deformable or rigid.
        other: The body that touches it; None: all others together.
        on: The frame that gives the axes, and the origin of moments, of the wrench: "world", an attachment, a
            joint with a frame (the frame that it moves), a rigid body.
        force_noise: Standard deviation in [N] of each component of the force.
        moment_noise: Standard deviation in [N m] of each component of the moment.
        force_bias: Bias of the force in [N].
        moment_bias: Bias of the moment in [N m].
    """

    kind: ClassVar[str] = "wrench"
    output_quantity: ClassVar[Quantity] = Quantity.WRENCH
    named_parts: ClassVar[Mapping[str, str]] = {"body": ANY_BODY, "other": ANY_BODY, "on": PLACE}
    body: str
    other: str | None = None
    on: str = "world"
    force_noise: float = 0.0
    moment_noise: float = 0.0
    force_bias: Vector = (0.0, 0.0, 0.0)
    moment_bias: Vector = (0.0, 0.0, 0.0)

    @property
    def axes(self) -> str:
        """Name of the frame of the wrench."""
        return self.on


class WrenchSensor(Sensor):
    """Sensor of the resultant contact force and moment on a body."""

    def __init__(self, described: WrenchSensorDescription, scenery: Scenery) -> None:
        super().__init__(
            both(described.force_noise, described.moment_noise),
            both(described.force_bias, described.moment_bias),
        )
        number, other = scenery.body_names.index, described.other
        self._body, self._other = number(described.body), None if other is None else number(other)
        self._place = scenery.places[described.on]

    def measure(self, observation: StepObservation) -> Array:
        """Return the force, then the moment, shape (6,)."""
        touching = observation.contacts
        own = touching.bodies == self._body
        if self._other is not None:
            own &= (touching.bodies == self._other)[:, ::-1]
        sign = own[:, 0].astype(float) - own[:, 1]
        forces = sign[:, None] * touching.forces
        origin, rotation = self._place.pose(observation.model, observation.state)
        moment = cross(touching.points - origin, forces).sum(axis=0)
        return np.concatenate([forces.sum(axis=0) @ rotation, moment @ rotation])


WRENCH = SensorKind(WrenchSensorDescription, WrenchSensor)
