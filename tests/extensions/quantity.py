"""The quantity of quantity.patch in a study's file: measured in a run, and listed among the known ones."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from softsim_core import Simulation
from softsim_core.lab.study import prepare_study, run_once
from softsim_core.scene import load_scene

STUDY = """
name: low
scene: cable_finger
variables: [{name: g, lower: 1.0, upper: 10.0}]
design: {kind: sobol, samples: 2, seed: 1}
overlay: {gravity: [0.0, 0.0, "= -g"]}
duration: 0.1
measure: [{name: low, of: body.finger.LOWEST}]
"""

with TemporaryDirectory() as folder:
    file = Path(folder, "low.yaml")
    file.write_text(STUDY.replace("LOWEST", "lowest"))
    outcome = run_once(prepare_study(file).work, [5.0])
    file.write_text(STUDY)
    unknown = run_once(prepare_study(file).work, [5.0])
simulation = Simulation(load_scene("cable_finger", {"gravity": [0.0, 0.0, -5.0]}))
for _ in range(10):
    simulation.step()
assert outcome.error == "", outcome.error
assert abs(float(outcome.results["low"]) - simulation.positions[:, 2].min()) < 1e-9
assert "body.NAME.lowest" in unknown.error, unknown.error
print("works")
