"""The sensors of a scene with their latest samples, and the registered kinds of sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from softsim_core.base import Array, Registry, SceneError, known_names
from softsim_core.physics.sensing.actuators import CABLE_SENSOR, CHAMBER_SENSOR
from softsim_core.physics.sensing.description import Scenery, SensorKind, SimulatedSensorDescription
from softsim_core.physics.sensing.force_torque import FORCE_TORQUE
from softsim_core.physics.sensing.imu import IMU
from softsim_core.physics.sensing.markers import MARKERS, STRAIN
from softsim_core.physics.sensing.sensor import SampleNoise, Sensor, StepObservation
from softsim_core.physics.sensing.tactile import TACTILE
from softsim_core.physics.sensing.wrench import WRENCH


@dataclass(frozen=True, slots=True, eq=False)
class SensorReading:
    """The latest sample of a sensor.

    Attributes:
        description: The sensor's description in the scene.
        value: The sample with noise and bias; shape and units depend on the kind.
        time: Simulated time of the sample in [s].
        number: Number of the sample since the start.
    """

    description: SimulatedSensorDescription
    value: Array
    time: float
    number: int


class Sensors:
    """The latest sample of every sensor: `sensors["tip"].value`; iterating gives the names.

    Args:
        built: Descriptions with their sensors.
        dt: Time step in [s].
    """

    def __init__(self, built: Sequence[tuple[SimulatedSensorDescription, Sensor]], dt: float) -> None:
        self._built, self._dt = tuple(built), dt
        self._noise = [SampleNoise(each.seed, each.name) for each, _ in built]
        self._readings: dict[str, SensorReading] = {}

    def sample(self, step: int, observation: StepObservation, *, anew: bool = False) -> None:
        """Sample the sensors that are due after a number of steps since the start; `anew`: all of them."""
        for (description, sensor), noise in zip(self._built, self._noise, strict=True):
            number = self._number(description, step)
            if anew or number != self._number(description, step - 1):
                generator = noise.of_sample(number) if sensor.random else None
                value = sensor.add_noise(sensor.measure(observation), generator)
                value.flags.writeable = False
                self._readings[description.name] = SensorReading(description, value, step * self._dt, number)

    def _number(self, description: SimulatedSensorDescription, step: int) -> int:
        """Return the number of samples due within a number of steps, without the one at the start."""
        return step if description.rate is None else math.floor(step * self._dt * description.rate + 1e-6)

    def __getitem__(self, name: str) -> SensorReading:
        """Return the latest sample of a sensor.

        Raises:
            SceneError: no sensor has the name.
        """
        if name not in self._readings:
            raise SceneError(f"unknown sensor {name!r}; {known_names(name, self._readings)}")
        return self._readings[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._readings)

    def __len__(self) -> int:
        return len(self._built)


_kinds: Registry[SensorKind] = Registry(
    "sensor kind", WRENCH, FORCE_TORQUE, TACTILE, STRAIN, IMU, MARKERS, CABLE_SENSOR, CHAMBER_SENSOR
)


def register_sensor(
    description: type[SimulatedSensorDescription], build: Callable[[Any, Scenery], Sensor]
) -> None:
    """Register a kind of sensor under the `kind` of its description.

    Args:
        description: A frozen dataclass derived from SimulatedSensorDescription; scene files give its fields.
        build: Returns the sensor of a description and the scenery.

    Raises:
        SceneError: the name is empty or a kind of the package.
    """
    if not isinstance(description.kind, str) or not description.kind.isidentifier():
        raise SceneError(
            f"sensor kind {description.__name__} refused: give it `kind: ClassVar[str]`, a word of letters, "
            "digits and underscores"
        )
    _kinds.register(SensorKind(description, build))


def sensor_kinds() -> tuple[str, ...]:
    """Return the names of all kinds."""
    return _kinds.names()


def sensor_kind(name: str) -> SensorKind:
    """Return the kind with a name.

    Raises:
        SceneError: no kind has it.
    """
    return _kinds.get(name)
