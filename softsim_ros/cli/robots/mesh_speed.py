"""Measure a step of a mesh on this machine: a part of silicone, clamped at its lowest face, under gravity."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from softsim_core.lab.meshing import end_face
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.simulation import Simulation

PRESET = "Dragon Skin 10 MEDIUM"
POISSON = {1: 0.45, 2: 0.49}
"""Poisson ratio by the order of the cells; linear ones lock at larger values."""
STIFFNESS_FACTOR = 1.75
"""Factor measured for that elastomer; its table value is too small."""
DENSITY = 1070.0
"""Density in [kg/m^3]."""
DT = 0.01
_WARM, _TIMED = 3, 11


def clamped_part(mesh: TetMesh) -> SceneDescription:
    """Return a scene of the part alone, clamped, in SI units, z up."""
    body = BodyDescription(
        name="part",
        mesh=mesh,
        material=MaterialDescription(
            preset=PRESET, stiffness_factor=STIFFNESS_FACTOR, poisson_ratio=POISSON[mesh.order]
        ),
        density=DENSITY,
    )
    base = AttachmentDescription(name="base", body="part", to="world", box=end_face(mesh.points))
    solver = SolverSettings(rayleigh_stiffness=0.01)
    return SceneDescription(name="part", dt=DT, bodies=(body,), attachments=(base,), solver=solver)


def step_time(mesh: TetMesh) -> float:
    """Return the median time in [s] of a step."""
    simulation = Simulation(clamped_part(mesh))
    times = []
    for step in range(_WARM + _TIMED):
        start = perf_counter()
        simulation.step()
        if step >= _WARM:
            times.append(perf_counter() - start)
    return float(np.median(times))
