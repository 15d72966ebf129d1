"""Markers on bodies as a camera sees them: positions with noise and random dropouts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import POINT, Array, FieldError, SceneError, Vector, need_finite
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
    points: tuple[Vector, ...] = field(metadata=POINT)
    body: str | None = None
    noise: float = 0.0
    camera: Vector | None = None
    depth_noise: float = 0.0
    dropout: float = 0.0

    def check(self) -> None:
        """Refuse values that are not allowed, no points, and depth noise without a camera.

        Raises:
            FieldError: a field has a value that is not allowed.
            SceneError: `depth_noise` is given without a camera.
        """
        if not self.points:
            raise FieldError(self.owner, "points", "none", "at least one point")
        for point in (*self.points, *(() if self.camera is None else (self.camera,))):
            need_finite(self.owner, "points and camera", point)
        self.need_noise(noise=self.noise, depth_noise=self.depth_noise)
        if self.depth_noise and self.camera is None:
            raise SceneError(
                f"{self.owner}: depth_noise needs a camera; give its place, or remove depth_noise"
            )
        if not 0.0 <= self.dropout <= 1.0:
            raise FieldError(self.owner, "dropout", self.dropout, "in 0 to 1")

    def references(self) -> tuple[Reference, ...]:
        """Return the deformable body that carries the markers, if one is named."""
        return () if self.body is None else (Reference("body", self.body, SOFT_BODY),)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The positions of the markers."""
        return (Output(Quantity.POINTS),)

    @property
    def axes(self) -> str:
        """Name of the world."""
        return "world"


class Markers(Sensor):
    """Sensor of marker positions on deformable bodies.

    Args:
        points: The marked points of the bodies.
        described: Noise, camera, dropout.
    """

    def __init__(self, points: Points, described: MarkersDescription) -> None:
        super().__init__(described.noise)
        self._points, self._described = points, described

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


def _build_markers(described: MarkersDescription, scenery: Scenery) -> Markers:
    points = np.array(described.points)
    if described.body is not None:
        return Markers(scenery.soft.bind(described.owner, described.body, points), described)
    found = []
    for number, point in enumerate(points):
        on = scenery.soft.bind_near(point)
        if on is None:
            raise SceneError(
                f"{described.owner}: no deformable body is at point {number}, {point.tolist()} m; give where "
                "it sits on the robot at the start"
            )
        found.append(on)
    nodes, weights = (np.concatenate(each) for each in zip(*found, strict=True))
    return Markers(Points(nodes, weights), described)


MARKERS = SensorKind(MarkersDescription, _build_markers)
