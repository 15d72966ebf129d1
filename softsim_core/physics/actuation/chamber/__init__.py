"""Chambers: hollows of a body, filled with air or water, commanded by pressure or by volume."""

from softsim_core.physics.actuation.chamber.chamber import Chamber, ChamberView
from softsim_core.physics.actuation.chamber.chambers import CHAMBER
from softsim_core.physics.actuation.chamber.description import ATMOSPHERE, ChamberDescription

__all__ = ["ATMOSPHERE", "CHAMBER", "Chamber", "ChamberDescription", "ChamberView"]
