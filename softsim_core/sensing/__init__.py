"""Sensing: what the sensors of a scene measure, each at its own rate, with noise from a seed of its own."""

from softsim_core.sensing.building import Scenery, SensorKind
from softsim_core.sensing.cable import CableSensorDescription
from softsim_core.sensing.chamber import ChamberSensorDescription
from softsim_core.sensing.description import Reference, SimulatedSensorDescription
from softsim_core.sensing.force_torque import ForceTorqueDescription
from softsim_core.sensing.imu import ImuDescription
from softsim_core.sensing.markers import MarkersDescription
from softsim_core.sensing.registry import register_sensor, sensor_kind, sensor_kinds
from softsim_core.sensing.sensor import Seen, Sensor
from softsim_core.sensing.sensors import SensorReading, Sensors
from softsim_core.sensing.strain import StrainSensorDescription
from softsim_core.sensing.tactile import TactileArrayDescription
from softsim_core.sensing.wrench import WrenchSensorDescription

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
