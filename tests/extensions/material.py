"""The law of material.patch: its energy by its formula, and a beam of it, the same compiled and in SciPy."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from softsim_core import Simulation
from softsim_core.physics.dynamics.numba_backend import compiled_law
from softsim_core.physics.fem.materials import material
from softsim_core.scene import load_scene

MODULUS, SEGMENTS = 4e4, 5.0
VALUES = {"shear_modulus": MODULUS, "segments": SEGMENTS, "poisson_ratio": 0.45}

law = material("arruda_boyce")
p = np.array([law.values(VALUES)[name] for name in law.names])
rng = np.random.default_rng(5)
for deformation in np.eye(3) + rng.uniform(-0.5, 0.5, (20, 3, 3)):
    invariant, volume = (deformation**2).sum(), np.linalg.det(deformation)
    terms = [
        scale * (invariant**k - 3.0**k)
        for k, scale in ((1, 0.5), (2, 1 / (20 * SEGMENTS)), (3, 11 / (1050 * SEGMENTS**2)))
    ]
    factor = MODULUS / (1.0 + 0.6 / SEGMENTS + 2 * 27 * 11 / (1050 * SEGMENTS**2))
    expected = factor * sum(terms) - MODULUS * (volume - 1.0)
    assert np.isclose(law.shear_energy(deformation, p), expected, rtol=1e-10)

assert compiled_law(law) is not None
SCENE = f"""
name: chains
bodies:
  - name: beam
    mesh: {{file: {Path("configs", "meshes", "beam.vtk").resolve()}}}
    material: {{law: arruda_boyce, shear_modulus: {MODULUS}, segments: {SEGMENTS}, poisson_ratio: 0.45}}
    density: 1070.0
attachments:
  - {{name: clamp, body: beam, to: world, box: {{center: [0.0, 0.0, 0.0], size: [0.0002, 0.04, 0.04]}}}}
"""
with TemporaryDirectory() as folder:
    file = Path(folder, "chains.yaml")
    file.write_text(SCENE)
    scene = load_scene(file)
ends = []
for backend in ("numba", "scipy"):
    simulation = Simulation(scene, backend=backend)
    for _ in range(5):
        simulation.step()
    ends.append(simulation.positions)
assert np.abs(ends[0] - ends[1]).max() < 1e-9
assert ends[0][:, 2].min() < -0.0155
print("works")
