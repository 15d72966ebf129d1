"""The strain of a line in a body: a bend sensor, a stretch sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import POINT, Array, FieldError, Vector, need_finite
from softsim_core.physics.actuation import Points
from softsim_core.physics.sensing.description import (
    SOFT_BODY,
    Output,
    Quantity,
    Reference,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class StrainSensorDescription(SimulatedSensorDescription):
    """The mean strain of a line through points of a body: current length / length at the start - 1.

    At a distance from the middle of a body that bends, it is the curvature times this distance: a bend
    sensor.

    Attributes:
        body: The deformable body that carries the points.
        points: At least two, in [m], in the world at the start, from one end to the other.
        noise: Standard deviation of a sample in [-].
        bias: Bias in [-].
    """

    kind: ClassVar[str] = "strain"
    body: str
    points: tuple[Vector, ...] = field(metadata=POINT)
    noise: float = 0.0
    bias: float = 0.0

    def check(self) -> None:
        """Refuse fewer than two points, equal neighbours, values that are not finite and negative noise."""
        if len(self.points) < 2:
            raise FieldError(self.owner, "points", len(self.points), "at least two points")
        for point in self.points:
            need_finite(self.owner, "points", point)
        if any(one == two for one, two in zip(self.points, self.points[1:], strict=False)):
            raise FieldError(self.owner, "points", "two equal ones in a row", "points apart from each other")
        self.need_noise(noise=self.noise)
        self.need_bias(bias=self.bias)

    def references(self) -> tuple[Reference, ...]:
        """Return the deformable body that carries the points."""
        return (Reference("body", self.body, SOFT_BODY),)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The strain."""
        return (Output(Quantity.NUMBER),)


class StrainSensor(Sensor):
    """Sensor of the mean strain of a line through points of a body.

    Args:
        points: The points of the line.
        rest: Positions of the nodes at the start in [m], shape (n, 3).
        noise, bias: Noise and bias of the strain.
    """

    def __init__(self, points: Points, rest: Array, noise: float, bias: float) -> None:
        super().__init__(noise, bias)
        self._points = points
        self._rest_length = self._length(rest)

    def measure(self, observation: StepObservation) -> Array:
        """Return the strain, shape ()."""
        return np.asarray(self._length(observation.state.positions) / self._rest_length - 1.0)

    def _length(self, positions: Array) -> float:
        line = np.einsum("pa,pai->pi", self._points.weights, positions[self._points.nodes])
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _build_strain(described: StrainSensorDescription, scenery: Scenery) -> StrainSensor:
    points = scenery.soft.bind(described.owner, described.body, np.array(described.points))
    return StrainSensor(points, scenery.soft.model.rest, described.noise, described.bias)


STRAIN = SensorKind(StrainSensorDescription, _build_strain)
