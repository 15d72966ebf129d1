"""The quantity of quantity.patch: read from a running scene under its name."""

from __future__ import annotations

from softsim_core import Simulation
from softsim_core.lab.study import QuantityDescription, quantity
from softsim_core.scene import load_scene

simulation = Simulation(load_scene("cable_finger"))
found = quantity(QuantityDescription(name="low", of="body.finger.lowest"), simulation)
simulation.step()
assert (found.unit, found.shape) == ("m", ())
assert float(found.read(simulation)) == simulation.positions[:, 2].min()
print("works")
