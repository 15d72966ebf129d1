"""Sensing: what the sensors of a scene measure, each at its own rate, with noise from a seed of its own."""

from softsim_core.physics.sensing.actuators import CableSensorDescription, ChamberSensorDescription
from softsim_core.physics.sensing.description import (
    Reference,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
)
from softsim_core.physics.sensing.force_torque import ForceTorqueDescription
from softsim_core.physics.sensing.imu import ImuDescription
from softsim_core.physics.sensing.markers import MarkersDescription
from softsim_core.physics.sensing.registry import register_sensor, sensor_kind, sensor_kinds
from softsim_core.physics.sensing.sensor import Seen, Sensor
from softsim_core.physics.sensing.sensors import SensorReading, Sensors
from softsim_core.physics.sensing.strain import StrainSensorDescription
from softsim_core.physics.sensing.tactile import TactileArrayDescription
from softsim_core.physics.sensing.wrench import WrenchSensorDescription

__all__ = [
    "CableSensorDescription",
    "ChamberSensorDescription",
    "ForceTorqueDescription",
    "ImuDescription",
    "MarkersDescription",
    "Reference",
    "Scenery",
    "Seen",
    "Sensor",
    "SensorKind",
    "SensorReading",
    "Sensors",
    "SimulatedSensorDescription",
    "StrainSensorDescription",
    "TactileArrayDescription",
    "WrenchSensorDescription",
    "register_sensor",
    "sensor_kind",
    "sensor_kinds",
]
