"""Sensors of actuators: length and tension of a cable, volume and pressure of a chamber."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.sensing.description import (
    Output,
    Quantity,
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
    named_parts: ClassVar[Mapping[str, str]] = {"joint": "cable"}
    joint: str
    length_noise: float = 0.0
    tension_noise: float = 0.0
    length_bias: float = 0.0
    tension_bias: float = 0.0

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Length and tension, as position and effort of the cable's joint."""
        return (Output(Quantity.JOINT, joint=self.joint),)


class ActuatorSensor(Sensor):
    """Sensor of an actuator's size, which grows or shrinks with its coordinate, and of its multiplier.

    Args:
        joint: Name of its joint.
        scenery: The scene.
        noise, bias: Noise and bias of size and multiplier.
    """

    def __init__(
        self, joint: str, scenery: Scenery, noise: tuple[float, float], bias: tuple[float, float]
    ) -> None:
        super().__init__(noise, bias)
        self._joint, self._size = scenery.soft.joint(joint), scenery.actuators[joint].measured_size

    def measure(self, observation: StepObservation) -> Array:
        """Return the size, then the multiplier, shape (2,)."""
        state, j, size = observation.state, self._joint, self._size
        return np.array([size.at_zero + size.sign * state.joint_positions[j], state.joint_efforts[j]])


def _cable_sensor(described: CableSensorDescription, scenery: Scenery) -> ActuatorSensor:
    noise, bias = described.length_noise, described.length_bias
    return ActuatorSensor(
        described.joint, scenery, (noise, described.tension_noise), (bias, described.tension_bias)
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
    named_parts: ClassVar[Mapping[str, str]] = {"joint": "chamber"}
    joint: str
    volume_noise: float = 0.0
    pressure_noise: float = 0.0
    volume_bias: float = 0.0
    pressure_bias: float = 0.0

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The pressure, and the volume below it."""
        pressure = Output(Quantity.PRESSURE, part=1, deviations=(self.pressure_noise,), joint=self.joint)
        return pressure, Output(Quantity.NUMBER, "/volume", part=0)


def _chamber_sensor(described: ChamberSensorDescription, scenery: Scenery) -> ActuatorSensor:
    noise, bias = described.volume_noise, described.volume_bias
    return ActuatorSensor(
        described.joint, scenery, (noise, described.pressure_noise), (bias, described.pressure_bias)
    )


CHAMBER_SENSOR = SensorKind(ChamberSensorDescription, _chamber_sensor)
