"""What sensors see of a simulation: rows of its motion, and how far a measurement is from it.

A row says how fast a coordinate of a sensor moves with nodes, frames and joints, see mechanics.rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.base import Array, IndexArray, SceneError
from softsim_core.physics.mechanics import Model, Pose, Rows, rotation_log, rotation_of
from softsim_core.scene.building import surroundings
from softsim_core.simulation import Simulation


class Sensor(Protocol):
    """What is measured at one place, in m coordinates that are believed or refused together.

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
        """The motion of its coordinates, m rows."""
        ...

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """What was measured less what the simulation says, shape (m,); NaN where nothing was measured."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PoseSensor:
    """The effector's pose, or a part of it: `measured` is a Pose, not finite where it is not known.

    Attributes:
        noise: Three of the position in [m], three of the rotation about world axes in [rad]; infinite: not
            used, as the heading of an IMU without magnetometer.
    """

    name: str
    frame: int
    noise: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """Three lengths, three angles."""
        return (False, False, False, True, True, True)

    def rows(self, model: Model) -> Rows:
        """See Sensor."""
        return frame_rows(model, self.frame)

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """See Sensor."""
        pose, expected = measured, simulation.effector_pose
        assert isinstance(pose, Pose)
        assert expected is not None
        norm = float(np.linalg.norm(pose.quaternion_xyzw))
        turn = np.full(3, np.nan)
        if 1e-6 < norm < np.inf:
            rotation = rotation_of(pose.quaternion_xyzw / norm)
            turn = rotation_log(rotation @ rotation_of(expected.quaternion_xyzw).T)
        return np.where(np.isfinite(self.noise), np.append(pose.position - expected.position, turn), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class PointSensor:
    """A marker in or on a body: `measured` is its position (3,) in [m], not finite where it is not seen."""

    name: str
    nodes: IndexArray
    weights: Array
    noise: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """No angles."""
        return (False, False, False)

    def rows(self, model: Model) -> Rows:
        """See Sensor."""
        return point_rows(self.nodes, self.weights)

    def innovation(self, simulation: Simulation, measured: object) -> Array:
        """See Sensor."""
        return np.asarray(measured, dtype=float) - self.weights @ simulation.positions[self.nodes]


def effector_sensor(
    simulation: Simulation, name: str, position_noise: float, rotation_noise: float, tilt_only: bool = False
) -> PoseSensor:
    """A sensor of the effector's pose.

    Args:
        simulation: With a free frame as end effector.
        name: Of the sensor.
        position_noise: In [m]; infinite: positions are not measured.
        rotation_noise: In [rad]; infinite: rotations are not measured.
        tilt_only: The turn about the vertical is not measured.

    Raises:
        SceneError: there is no end effector.
    """
    heading = np.inf if tilt_only else rotation_noise
    noise = np.array([*[position_noise] * 3, rotation_noise, rotation_noise, heading])
    return PoseSensor(name, effector_frame(simulation), noise)


def effector_frame(simulation: Simulation) -> int:
    """Number of the free frame that is the end effector.

    Raises:
        SceneError: there is none.
    """
    name = simulation.scene.effector
    if name is None:
        raise SceneError(
            f"scene {simulation.scene.name} has no end effector (key `effector`): give its markers' places"
        )
    return simulation.model.frame_names.index(name)


def marker_sensors(simulation: Simulation, places: Array, noise: float) -> list[PointSensor]:
    """Markers `marker_0`, `marker_1`, ... on the bodies that are at `places` (k, 3) in [m] at rest.

    Args:
        simulation: Any of the scene.
        places: On the robot at rest, in the world.
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
    """Velocity and spin of a free frame: six rows."""
    place = len(model.rest) + 6 * frame + np.arange(6)
    return Rows(np.arange(7), place, np.tile([1.0, 0.0, 0.0], (6, 1)))


def point_rows(nodes: IndexArray, weights: Array) -> Rows:
    """Velocity of a point that follows nodes (a,) with weights (a,): three rows."""
    count = len(nodes)
    coefficient = np.zeros((3, count, 3))
    for axis in range(3):
        coefficient[axis, :, axis] = weights
    return Rows(count * np.arange(4), np.tile(nodes, 3), coefficient.reshape(-1, 3))


def field_rows(nodes: IndexArray, fields: Array) -> Rows:
    """One row for each field of forces on the same nodes (a,): `fields` of shape (r, a, 3) in [N]."""
    return Rows(
        len(nodes) * np.arange(len(fields) + 1), np.tile(nodes, len(fields)), fields.reshape(-1, 3).copy()
    )
