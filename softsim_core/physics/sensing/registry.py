"""The registered kinds of sensors: those of the package and those of users."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from softsim_core.base import Registry, SceneError
from softsim_core.physics.sensing.actuators import CABLE_SENSOR, CHAMBER_SENSOR
from softsim_core.physics.sensing.description import Scenery, SensorKind, SimulatedSensorDescription
from softsim_core.physics.sensing.force_torque import FORCE_TORQUE
from softsim_core.physics.sensing.imu import IMU
from softsim_core.physics.sensing.markers import MARKERS
from softsim_core.physics.sensing.sensor import Sensor
from softsim_core.physics.sensing.strain import STRAIN
from softsim_core.physics.sensing.tactile import TACTILE
from softsim_core.physics.sensing.wrench import WRENCH

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
