"""A running scene: the public face of the physics."""

from __future__ import annotations

from softsim_core.simulation.simulation import Simulation

__all__ = ["Simulation"]
