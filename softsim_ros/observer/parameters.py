"""The observer's parameters: what is measured, how well, and how far the model may be off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError
from softsim_core.observer.sensors import Sensor, effector_sensor, marker_sensors
from softsim_core.observer.settings import ObserverSettings
from softsim_core.simulation import Simulation
from softsim_node.parameters import parameter
from softsim_ros.robot_node import RobotSettings

EFFECTOR: Final = "effector"
IMU: Final = "imu"
MARKER: Final = "marker_"

_OWN: Final = ObserverSettings()


@dataclass(frozen=True, kw_only=True)
class ObserverParameters(RobotSettings):
    """Values of the parameters; those of `ObserverSettings` have its names."""

    pose_topic: str = parameter("effector_pose", "Measured pose of the effector; empty: none", fixed=True)
    marker_topic: str = parameter("markers", "Measured places of markers, in their order", fixed=True)
    imu_topic: str = parameter("imu", "Measured tilt of the effector; empty: none", fixed=True)
    marker_places: str = parameter(
        "", "Where the markers sit on the robot at rest, as x y z; x y z and so on", unit="m", fixed=True
    )
    position_noise: float = parameter(
        1e-4, "Noise of measured places along an axis", unit="m", within=(1e-6, 0.1), fixed=True
    )
    rotation_noise: float = parameter(
        5e-3, "Noise of measured rotations about an axis", unit="rad", within=(1e-5, 1.0), fixed=True
    )
    base_shift: float = parameter(
        0.0,
        "Shift of the joint bases where no simulator tells it on base_shift: how the robot is mounted",
        unit="m",
        within=(-1.0, 1.0),
        fixed=True,
    )
    mesh_rate: float = parameter(
        30.0, "Messages per second on mesh/points", unit="Hz", within=(0.0, 100.0), fixed=True
    )
    joint_offset: float = parameter(
        _OWN.joint_offset, "How far zeros of joints may be off", unit="rad", within=(0.0, 1.0), fixed=True
    )
    load_share: float = parameter(
        _OWN.load_share, "Share by which weight, or softness, may be off", within=(0.0, 10.0), fixed=True
    )
    push: float = parameter(
        _OWN.push,
        "Steady force on the effector, such as of a tool",
        unit="N",
        within=(0.0, 100.0),
        fixed=True,
    )
    sensor_offset: float = parameter(
        _OWN.sensor_offset,
        "How far sensors may be from where they are said to be",
        unit="m",
        within=(0.0, 0.1),
        fixed=True,
    )
    sensor_turn: float = parameter(
        _OWN.sensor_turn, "How far they may be turned", unit="rad", within=(0.0, 1.0), fixed=True
    )
    latency: float = parameter(
        _OWN.latency, "How late or early sensors may be", unit="s", within=(0.0, 1.0), fixed=True
    )
    false_contacts: float = parameter(
        _OWN.false_contacts, "Expected false contacts per hour", unit="1/h", within=(1e-9, 3600.0), fixed=True
    )

    @property
    def settings(self) -> ObserverSettings:
        """How far the model may be off.

        Raises:
            SoftSimError: a value cannot be.
        """
        known = {field.name for field in dataclasses.fields(ObserverSettings)}
        own = [field.name for field in dataclasses.fields(self) if field.name in known]
        return ObserverSettings(**{name: getattr(self, name) for name in own})

    @property
    def places(self) -> Array:
        """Where the markers sit, in [m], shape (k, 3).

        Raises:
            ConfigError: the text is not three numbers for each.
        """
        rows = [row.split() for row in self.marker_places.split(";") if row.strip()]
        try:
            places = np.array(rows, dtype=float).reshape(-1, 3)
        except ValueError:
            places = np.full((1, 3), np.nan)
        if not np.isfinite(places).all():
            raise ConfigError(
                "observer",
                "parameter marker_places",
                f"{self.marker_places!r} is no list of places; give three numbers in m for each, such as "
                "0.01 0 0.03; 0 0 0.03",
            )
        return places

    def sensors(self, model: Simulation) -> Sequence[Sensor]:
        """The sensors, named EFFECTOR, IMU and MARKER with a number; without effector only markers.

        Raises:
            SoftSimError: no body is at a marker's place.
        """
        sensors: list[Sensor] = []
        if model.scene.effector is not None:
            where, turn = self.position_noise, self.rotation_noise
            sensors.append(effector_sensor(model, EFFECTOR, where, turn))
            sensors.append(effector_sensor(model, IMU, np.inf, turn, tilt_only=True))
        return [*sensors, *marker_sensors(model, self.places, self.position_noise)]
