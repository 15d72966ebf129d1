"""Actuation: actuators and their kinds, joint limits, commands, animations."""

from softsim_core.actuation.actuator import Actuator, ActuatorView, GeometricStiffness
from softsim_core.actuation.building import ActuatorDescription, ActuatorKind, Placed, Surroundings
from softsim_core.actuation.registry import actuator_kind, actuator_kinds, register_actuator, register_kind

__all__ = [
    "Actuator",
    "ActuatorDescription",
    "ActuatorKind",
    "ActuatorView",
    "GeometricStiffness",
    "Placed",
    "Surroundings",
    "actuator_kind",
    "actuator_kinds",
    "register_actuator",
    "register_kind",
]
