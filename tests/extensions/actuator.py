"""The actuator of actuator.patch in a scene's file: it pulls, and the page's editor offers its number."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from softsim_core import Simulation
from softsim_core.scene import load_scene

FINGER = Path("configs", "scenes", "cable_finger.yaml").resolve()
SCENE = """
extends: {FINGER}
name: winched
joints:
  - name: pull
    kind: winch
    winch: {body: finger, point: [0.0075, -0.1, 0.0075], winch: [0.0075, -0.1, 0.2], stiffness: 200.0}
poses: {start: [0.0, 0.0], bent: [0.0, 0.02]}
keys: {}
"""

with TemporaryDirectory() as folder:
    file = Path(folder, "winched.yaml")
    file.write_text(SCENE.replace("{FINGER}", str(FINGER)))
    robot = load_scene(file)
simulation = Simulation(robot)
balance = simulation.equilibrium([0.0, 0.02])
assert 0.0 < balance.state.joint_positions[1] < 0.02
assert abs(balance.state.joint_efforts[1] - 200.0 * (0.02 - balance.state.joint_positions[1])) < 1e-6
(number,) = robot.joints[1].actuator.edited_numbers
assert number.label == "Stiffness [N/mm]"
print("works")
