"""The element of element.patch: wedges of a file beside hexahedra, the patch test, and a beam that bends."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import meshio
import numpy as np

from softsim_core import Simulation
from softsim_core.physics.fem import elastic_forces
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import load_scene

HALVES = ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))

SCENE = """
name: bent
bodies:
  - name: beam
    mesh: {{file: {file}}}
    material: {{law: stable_neo_hookean, young_modulus: 100000.0, poisson_ratio: 0.45}}
    total_mass: 0.02
attachments:
  - {{name: clamp, body: beam, to: world, box: {{center: [0.0, 0.01, 0.01], size: [0.0002, 0.04, 0.04]}}}}
gravity: [0.0, 0.0, -1.0]
"""

bar = box_mesh((0.1, 0.02, 0.02), (30, 3, 3), hexahedra=True)
cells = bar.blocks["hexahedron"].cells
middle = bar.points[cells].mean(axis=1)[:, 0]
split = cells[middle < 0.05]
wedges = np.concatenate([split[:, half] for half in HALVES])
inner = (np.abs(bar.points - [0.05, 0.01, 0.01]) < [0.0499, 0.0099, 0.0099]).all(axis=1)
moved = bar.points + 5e-4 * inner[:, None] * np.random.default_rng(3).uniform(-1.0, 1.0, bar.points.shape)

ends = {}
with TemporaryDirectory() as folder:
    for name, points, kinds in (
        ("irregular", moved, [("wedge", wedges), ("hexahedron", cells[middle > 0.05])]),
        ("mixed", bar.points, [("wedge", wedges), ("hexahedron", cells[middle > 0.05])]),
        ("hexahedra", bar.points, [("hexahedron", cells)]),
    ):
        file = Path(folder, f"{name}.vtk")
        meshio.write(file, meshio.Mesh(points, kinds))
        scene = Path(folder, f"{name}.yaml")
        scene.write_text(SCENE.format(file=file))
        for backend in ("numba", "scipy") if name == "mixed" else ("numba",):
            simulation = Simulation(load_scene(scene), backend=backend)
            elements = {group.element.name for group in simulation.model.groups}
            assert elements == ({"hex8"} if name == "hexahedra" else {"hex8", "wedge6"}), elements
            for _ in range(5):
                simulation.step()
            ends[name, backend] = simulation.positions
            rest = simulation.model.rest
        if name == "irregular":
            gradient = np.eye(3) + 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, (3, 3))
            values = [{"young_modulus": 1e5, "poisson_ratio": 0.45}]
            forces = elastic_forces(simulation.model.groups, rest @ gradient.T, values)
            assert np.abs(forces[inner]).max() < 1e-9 * np.abs(forces).max()
sag = {key: (positions - rest)[rest[:, 0] > 0.0999, 2].mean() for key, positions in ends.items()}
assert np.abs(ends["mixed", "numba"] - ends["mixed", "scipy"]).max() < 1e-9
assert abs(sag["mixed", "numba"] / sag["hexahedra", "numba"] - 1.0) < 0.05, sag
print("works")
