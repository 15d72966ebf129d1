"""Sensors of actuators: length and tension of a cable, volume and pressure of a chamber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation import MeasuredSize
from softsim_core.physics.sensing.description import (
    Output,
    Quantity,
    Reference,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class CableSensorDescription(SimulatedSensorDescription):
    """Length in [m] and tension in [N] of a cable.

    Attributes:
        joint: Name of the joint of kind `cable`.
        length_noise: Standard deviation of a length sample in [m].
        tension_noise: Standard deviation of a tension sample in [N].
        length_bias: Bias of the length in [m].
        tension_bias: Bias of the tension in [N].
    """

    kind: ClassVar[str] = "cable"
    joint: str
    length_noise: float = 0.0
    tension_noise: float = 0.0
    length_bias: float = 0.0
    tension_bias: float = 0.0

    def check(self) -> None:
        """Refuse negative or infinite noise and infinite bias."""
        self.need_noise(length_noise=self.length_noise, tension_noise=self.tension_noise)
        self.need_bias(length_bias=self.length_bias, tension_bias=self.tension_bias)

    def references(self) -> tuple[Reference, ...]:
        """Return the cable's joint, the only part of the scene that the sensor names."""
        return (Reference("joint", self.joint, "cable"),)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Length and tension, as position and effort of the cable's joint."""
        return (Output(Quantity.JOINT, joint=self.joint),)


class ActuatorSensor(Sensor):
    """Sensor of an actuator's size, which grows or shrinks with its coordinate, and of its multiplier.

    Args:
        joint: Number of its joint.
        size: Its size as a function of the joint's position.
        noise, bias: Noise and bias of size and multiplier, shape (2,).
    """

    def __init__(self, joint: int, size: MeasuredSize, noise: Array, bias: Array) -> None:
        super().__init__(noise, bias)
        self._joint, self._size = joint, size

    def measure(self, observation: StepObservation) -> Array:
        """Return the size, then the multiplier, shape (2,)."""
        state, j, size = observation.state, self._joint, self._size
        return np.array([size.at_zero + size.sign * state.joint_positions[j], state.joint_efforts[j]])


def _cable_sensor(described: CableSensorDescription, scenery: Scenery) -> ActuatorSensor:
    return ActuatorSensor(
        scenery.soft.joint(described.joint),
        scenery.actuators[described.joint].measured_size,
        np.array([described.length_noise, described.tension_noise]),
        np.array([described.length_bias, described.tension_bias]),
    )


CABLE_SENSOR = SensorKind(CableSensorDescription, _cable_sensor)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSensorDescription(SimulatedSensorDescription):
    """Volume in [m^3] of a chamber's hollow and its gauge pressure in [Pa].

    Attributes:
        joint: Name of the joint of kind `chamber`.
        volume_noise: Standard deviation of a volume sample in [m^3].
        pressure_noise: Standard deviation of a pressure sample in [Pa].
        volume_bias: Bias of the volume in [m^3].
        pressure_bias: Bias of the pressure in [Pa].
    """

    kind: ClassVar[str] = "chamber"
    joint: str
    volume_noise: float = 0.0
    pressure_noise: float = 0.0
    volume_bias: float = 0.0
    pressure_bias: float = 0.0

    def check(self) -> None:
        """Refuse negative or infinite noise and infinite bias."""
        self.need_noise(volume_noise=self.volume_noise, pressure_noise=self.pressure_noise)
        self.need_bias(volume_bias=self.volume_bias, pressure_bias=self.pressure_bias)

    def references(self) -> tuple[Reference, ...]:
        """Return the chamber's joint, the only part of the scene that the sensor names."""
        return (Reference("joint", self.joint, "chamber"),)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The pressure, and the volume below it."""
        pressure = Output(Quantity.PRESSURE, part=1, deviations=(self.pressure_noise,), joint=self.joint)
        return pressure, Output(Quantity.NUMBER, "/volume", part=0)


def _chamber_sensor(described: ChamberSensorDescription, scenery: Scenery) -> ActuatorSensor:
    return ActuatorSensor(
        scenery.soft.joint(described.joint),
        scenery.actuators[described.joint].measured_size,
        np.array([described.volume_noise, described.pressure_noise]),
        np.array([described.volume_bias, described.pressure_bias]),
    )


CHAMBER_SENSOR = SensorKind(ChamberSensorDescription, _chamber_sensor)
