"""The resultant of all contacts on a body: a force and a moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softsim_core.base import Array, Vector
from softsim_core.physics.mechanics import cross
from softsim_core.physics.sensing.description import (
    ANY_BODY,
    PLACE,
    Output,
    Quantity,
    Reference,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
    both,
)
from softsim_core.physics.sensing.sensor import Place, Sensor, StepObservation


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
    body: str
    other: str | None = None
    on: str = "world"
    force_noise: float = 0.0
    moment_noise: float = 0.0
    force_bias: Vector = (0.0, 0.0, 0.0)
    moment_bias: Vector = (0.0, 0.0, 0.0)

    def check(self) -> None:
        """Refuse negative or infinite noise and infinite bias."""
        self.need_noise(force_noise=self.force_noise, moment_noise=self.moment_noise)
        self.need_bias(force_bias=self.force_bias, moment_bias=self.moment_bias)

    def references(self) -> tuple[Reference, ...]:
        """Return the touched body, the other body if one is named, and the frame of the wrench."""
        others = () if self.other is None else (Reference("other", self.other, ANY_BODY),)
        return (Reference("body", self.body, ANY_BODY), *others, Reference("on", self.on, PLACE))

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The wrench."""
        return (Output(Quantity.WRENCH),)

    @property
    def axes(self) -> str:
        """Name of the frame of the wrench."""
        return self.on


class WrenchSensor(Sensor):
    """Sensor of the resultant contact force and moment on a body.

    Args:
        body: Number of the body.
        other: Number of the body that touches it, or -1: any.
        place: The frame.
        noise, bias: Noise and bias of force and moment, shape (6,).
    """

    def __init__(self, body: int, other: int, place: Place, noise: Array, bias: Array) -> None:
        super().__init__(noise, bias)
        self._body, self._other, self._place = body, other, place

    def measure(self, observation: StepObservation) -> Array:
        """Return the force, then the moment, shape (6,)."""
        touching = observation.contacts
        own = touching.bodies == self._body
        if self._other >= 0:
            own &= (touching.bodies == self._other)[:, ::-1]
        sign = own[:, 0].astype(float) - own[:, 1]
        forces = sign[:, None] * touching.forces
        origin, rotation = self._place.pose(observation.model, observation.state)
        moment = cross(touching.points - origin, forces).sum(axis=0)
        return np.concatenate([forces.sum(axis=0) @ rotation, moment @ rotation])


def _build_wrench(described: WrenchSensorDescription, scenery: Scenery) -> WrenchSensor:
    number = scenery.body_names.index
    return WrenchSensor(
        number(described.body),
        -1 if described.other is None else number(described.other),
        scenery.places[described.on],
        both(described.force_noise, described.moment_noise),
        both(described.force_bias, described.moment_bias),
    )


WRENCH = SensorKind(WrenchSensorDescription, _build_wrench)
