"""Cables: frictionless lines through points that a body carries, pulled at one end."""

from softsim_core.physics.actuation.cable.builder import CABLE, cable_points
from softsim_core.physics.actuation.cable.cables import Cables, CableView
from softsim_core.physics.actuation.cable.description import CableDescription, read_cable_points

__all__ = ["CABLE", "CableDescription", "CableView", "Cables", "cable_points", "read_cable_points"]
