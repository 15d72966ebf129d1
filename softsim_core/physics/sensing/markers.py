"""Sensors of points on deformable bodies: markers as a camera sees them, and the strain of a line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import POINT, Array, FieldError, SceneError, Vector, need_finite
from softsim_core.physics.actuation import Points
from softsim_core.physics.sensing.description import (
    SOFT_BODY,
    Quantity,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkersDescription(SimulatedSensorDescription):
    """Positions of markers on deformable bodies in the world in [m]; NaN if not seen.

    Attributes:
        points: Positions at the start in [m], in the world.
        body: The deformable body that carries all of them; None: each lies on the nearest one.
        noise: Standard deviation of each coordinate in [m]; with a `camera`, of the coordinates across the
            line of sight.
        camera: Position of a camera in [m], in the world; None: the noise has no direction.
        depth_noise: Standard deviation along the line of sight of the camera in [m].
        dropout: Probability that a marker is not seen in a sample, independently of the others, 0 to 1.
    """

    kind: ClassVar[str] = "markers"
    output_quantity: ClassVar[Quantity] = Quantity.POINTS
    named_parts: ClassVar[Mapping[str, str]] = {"body": SOFT_BODY}
    points: tuple[Vector, ...] = field(metadata=POINT)
    body: str | None = None
    noise: float = 0.0
    camera: Vector | None = None
    depth_noise: float = 0.0
    dropout: float = 0.0

    def check(self) -> None:
        """Refuse no points, a dropout out of its interval, and depth noise without a camera (SceneError)."""
        if not self.points:
            raise FieldError(self.owner, "points", "none", "at least one point")
        for point in (*self.points, *(() if self.camera is None else (self.camera,))):
            need_finite(self.owner, "points and camera", point)
        if self.depth_noise and self.camera is None:
            raise SceneError(
                f"{self.owner}: depth_noise needs a camera; give its place, or remove depth_noise"
            )
        if not 0.0 <= self.dropout <= 1.0:
            raise FieldError(self.owner, "dropout", self.dropout, "in 0 to 1")

    @property
    def axes(self) -> str:
        """Name of the world."""
        return "world"


class Markers(Sensor):
    """Sensor of marker positions on deformable bodies.

    Raises:
        SceneError: no deformable body is at a point.
    """

    def __init__(self, described: MarkersDescription, scenery: Scenery) -> None:
        super().__init__(described.noise)
        self._described, points = described, np.array(described.points)
        if described.body is not None:
            self._points = scenery.soft.bind(described.owner, described.body, points)
            return
        found = []
        for number, point in enumerate(points):
            on = scenery.soft.bind_near(point)
            if on is None:
                raise SceneError(
                    f"{described.owner}: no deformable body is at point {number}, {point.tolist()} m; give "
                    "where it sits on the robot at the start"
                )
            found.append(on)
        self._points = Points(*(np.concatenate(each) for each in zip(*found, strict=True)))

    @property
    def random(self) -> bool:
        """Whether a sample has random noise or dropout."""
        described = self._described
        return max(described.noise, described.depth_noise, described.dropout) > 0.0

    def measure(self, observation: StepObservation) -> Array:
        """Return the positions in [m], shape (k, 3)."""
        carried = observation.state.positions[self._points.nodes]
        return np.asarray(np.einsum("pa,pai->pi", self._points.weights, carried))

    def add_noise(self, value: Array, generator: np.random.Generator | None) -> Array:
        """Return the positions with noise, NaN where a marker is not seen.

        With a camera, the noise along the line of sight has its own standard deviation.
        """
        if generator is None:
            return value
        described, away = self._described, generator.standard_normal(value.shape)
        sample = value + described.noise * away
        if described.camera is not None:
            sight = value - np.array(described.camera)
            sight /= np.linalg.norm(sight, axis=1, keepdims=True)
            along = np.einsum("pi,pi->p", away, sight)
            sample += (described.depth_noise - described.noise) * along[:, None] * sight
        sample[generator.random(len(value)) < described.dropout] = np.nan
        return sample


MARKERS = SensorKind(MarkersDescription, Markers)


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
    output_quantity: ClassVar[Quantity] = Quantity.NUMBER
    named_parts: ClassVar[Mapping[str, str]] = {"body": SOFT_BODY}
    body: str
    points: tuple[Vector, ...] = field(metadata=POINT)
    noise: float = 0.0
    bias: float = 0.0

    def check(self) -> None:
        """Refuse fewer than two points, equal neighbours, and values that are not finite."""
        if len(self.points) < 2:
            raise FieldError(self.owner, "points", len(self.points), "at least two points")
        for point in self.points:
            need_finite(self.owner, "points", point)
        if any(one == two for one, two in zip(self.points, self.points[1:], strict=False)):
            raise FieldError(self.owner, "points", "two equal ones in a row", "points apart from each other")


class StrainSensor(Sensor):
    """Sensor of the mean strain of a line through points of a body."""

    def __init__(self, described: StrainSensorDescription, scenery: Scenery) -> None:
        super().__init__(described.noise, described.bias)
        self._points = scenery.soft.bind(described.owner, described.body, np.array(described.points))
        self._rest_length = self._length(scenery.soft.model.rest)

    def measure(self, observation: StepObservation) -> Array:
        """Return the strain, shape ()."""
        return np.asarray(self._length(observation.state.positions) / self._rest_length - 1.0)

    def _length(self, positions: Array) -> float:
        line = np.einsum("pa,pai->pi", self._points.weights, positions[self._points.nodes])
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


STRAIN = SensorKind(StrainSensorDescription, StrainSensor)
