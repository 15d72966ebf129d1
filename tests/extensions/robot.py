"""The robot of robot.patch: found by its name, with keys and poses; its cable bends it."""

from __future__ import annotations

import numpy as np

from softsim_core import Simulation
from softsim_core.scene import load_scene

scene = load_scene("bending_beam")
assert scene.keys["plus"].joints == ("pull",)
simulation = Simulation(scene)
tips = [simulation.equilibrium(scene.poses[pose]).state.frame_positions[0] for pose in ("start", "bent")]
assert np.linalg.norm(tips[1] - tips[0]) > 0.01
print("works")
