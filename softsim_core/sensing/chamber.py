"""Volume and pressure of a chamber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softsim_core.actuation.chamber.chamber import ChamberView
from softsim_core.sensing.building import Scenery, SensorKind
from softsim_core.sensing.cable import ActuatorSensor
from softsim_core.sensing.description import Reference, SimulatedSensorDescription


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSensorDescription(SimulatedSensorDescription):
    """Volume in [m^3] of a chamber's hollow and pressure in it against the air around in [Pa].

    Attributes:
        joint: Name of the joint of kind `chamber`.
        volume_noise: Standard deviation of a sample in [m^3].
        pressure_noise: The same in [Pa].
        volume_bias: In [m^3].
        pressure_bias: In [Pa].
    """

    kind: ClassVar[str] = "chamber"
    joint: str
    volume_noise: float = 0.0
    pressure_noise: float = 0.0
    volume_bias: float = 0.0
    pressure_bias: float = 0.0

    def check(self) -> None:
        """See SimulatedSensorDescription."""
        self.need_noise(volume_noise=self.volume_noise, pressure_noise=self.pressure_noise)
        self.need_bias(volume_bias=self.volume_bias, pressure_bias=self.pressure_bias)

    def references(self) -> tuple[Reference, ...]:
        """See SimulatedSensorDescription."""
        return (Reference("joint", self.joint, "chamber"),)


def _built(described: ChamberSensorDescription, scenery: Scenery) -> ActuatorSensor:
    view = scenery.actuators[described.joint]
    assert isinstance(view, ChamberView)  # checked by the scene
    return ActuatorSensor(
        scenery.soft.joint(described.joint),
        1.0,
        view.volume - view.value,
        np.array([described.volume_noise, described.pressure_noise]),
        np.array([described.volume_bias, described.pressure_bias]),
    )


CHAMBER_SENSOR = SensorKind(ChamberSensorDescription, _built)
