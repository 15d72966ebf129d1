"""Sensor models of the observer: velocity rows, and differences between measurement and model.

A row expresses the velocity of one sensor coordinate by the velocities of nodes, frames and joints; see
mechanics.rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from softsim_core.base import Array, IndexArray, SceneError
from softsim_core.control.inverse import pose_difference
from softsim_core.physics.mechanics import Model, Pose, Rows
from softsim_core.scene.building import surroundings
from softsim_core.simulation import Simulation


class Sensor(Protocol):
    """Interface of a measurement at one place, with m coordinates that are accepted or rejected together.

    Attributes:
        name: Unique among the sensors of an observer.
        noise: Standard deviation of each coordinate in [m] or [rad], shape (m,).
        angular: Which coordinates are angles.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def noise(self) -> Array: ...  # noqa: D102
    @property
    def angular(self) -> tuple[bool, ...]: ...  # noqa: D102

    def rows(self, model: Model) -> Rows:
        """Return the velocity rows of the m coordinates."""
        ...

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """Return the measurement minus the simulated value, shape (m,); NaN where nothing was measured."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PoseSensor:
    """Pose of the effector, or part of it. `measured` is a Pose with non-finite numbers where it is unknown.

    Attributes:
        noise: Three standard deviations of the position in [m], then three of the rotation about world axes
            in [rad]. Infinite: the coordinate is not used, such as the heading of an IMU without
            magnetometer.
    """

    angular: ClassVar[tuple[bool, ...]] = (False, False, False, True, True, True)
    name: str
    frame: int
    noise: Array

    def rows(self, model: Model) -> Rows:
        """Return the six rows of the effector frame's velocity and spin."""
        return frame_rows(model, self.frame)

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """Return position difference in [m] and rotation vector in [rad], measured minus model, shape (6,).

        A coordinate is NaN where it was not measured or its noise is infinite.
        """
        expected = simulation.effector_pose
        assert isinstance(measured, Pose)
        assert expected is not None
        return np.where(np.isfinite(self.noise), pose_difference(measured, expected), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class PointSensor:
    """Marker in or on a body. `measured` is its position (3,) in [m], not finite where it is not visible."""

    angular: ClassVar[tuple[bool, ...]] = (False, False, False)
    name: str
    nodes: IndexArray
    weights: Array
    noise: Array

    def rows(self, model: Model) -> Rows:
        """Return the three rows of the marker's velocity."""
        return point_rows(self.nodes, self.weights)

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """Return the measured minus the simulated position in [m], shape (3,)."""
        return np.asarray(measured, dtype=float) - self.weights @ simulation.positions[self.nodes]


def effector_sensor(
    simulation: Simulation, name: str, position_noise: float, rotation_noise: float, tilt_only: bool = False
) -> PoseSensor:
    """Return a sensor of the effector's pose.

    Args:
        simulation: A simulation whose end effector is a free frame.
        name: Name of the sensor.
        position_noise: Standard deviation in [m]; infinite: positions are not measured.
        rotation_noise: Standard deviation in [rad]; infinite: rotations are not measured.
        tilt_only: Whether the rotation about the vertical is not measured.

    Raises:
        SceneError: the scene has no end effector.
    """
    heading = np.inf if tilt_only else rotation_noise
    noise = np.array([*[position_noise] * 3, rotation_noise, rotation_noise, heading])
    return PoseSensor(name, effector_frame(simulation), noise)


def effector_frame(simulation: Simulation) -> int:
    """Return the index of the free frame that is the end effector.

    Raises:
        SceneError: the scene has no end effector.
    """
    name = simulation.scene.effector
    if name is None:
        raise SceneError(
            f"scene {simulation.scene.name} has no end effector (key `effector`): give its markers' places"
        )
    return simulation.model.frame_names.index(name)


def marker_sensors(simulation: Simulation, places: Array, noise: float) -> list[PointSensor]:
    """Return sensors `marker_0`, `marker_1`, ... at places (k, 3) in [m] on the bodies at rest.

    Args:
        simulation: Any simulation of the scene.
        places: World positions on the robot at rest.
        noise: Standard deviation of each coordinate in [m].

    Raises:
        SceneError: no body is at a place.
    """
    sensors, around = [], surroundings(simulation.model, simulation.bodies)
    for number, place in enumerate(np.asarray(places, dtype=float).reshape(-1, 3)):
        on = around.bind_near(place)
        if on is None:
            raise SceneError(
                f"marker {number}: no body of {simulation.scene.name} is at {place.tolist()} m; give "
                "the place of the marker on the robot at rest"
            )
        sensors.append(PointSensor(f"marker_{number}", on.nodes[0], on.weights[0], np.full(3, noise)))
    return sensors


def frame_rows(model: Model, frame: int) -> Rows:
    """Return the six rows of a free frame's velocity and spin."""
    place = len(model.rest) + 6 * frame + np.arange(6)
    return Rows(np.arange(7), place, np.tile([1.0, 0.0, 0.0], (6, 1)))


def point_rows(nodes: IndexArray, weights: Array) -> Rows:
    """Return the three velocity rows of a point that follows nodes (a,) with weights (a,)."""
    count = len(nodes)
    coefficient = np.zeros((3, count, 3))
    for axis in range(3):
        coefficient[axis, :, axis] = weights
    return Rows(count * np.arange(4), np.tile(nodes, 3), coefficient.reshape(-1, 3))


def field_rows(nodes: IndexArray, fields: Array) -> Rows:
    """Return one row for each force field on the same nodes (a,): `fields` of shape (r, a, 3) in [N]."""
    return Rows(
        len(nodes) * np.arange(len(fields) + 1), np.tile(nodes, len(fields)), fields.reshape(-1, 3).copy()
    )
