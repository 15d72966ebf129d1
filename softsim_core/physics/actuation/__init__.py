"""Actuation: actuators and their kinds, joint limits, commands, animations."""

from softsim_core.physics.actuation.actuators import Actuator, ActuatorView, GeometricStiffness
from softsim_core.physics.actuation.building import ActuatorDescription, ActuatorKind, Placed, Surroundings
from softsim_core.physics.actuation.registry import (
    actuator_kind,
    actuator_kinds,
    register_actuator,
    register_kind,
)

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
