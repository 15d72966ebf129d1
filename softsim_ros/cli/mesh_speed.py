"""What a step of a mesh costs here: the part in silicone, held at its lowest face, under gravity."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from softsim_core.mesh.types import TetMesh
from softsim_core.scene.description import (
    AttachmentDescription,
    BodyDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.scene.material import MaterialDescription
from softsim_core.simulation import Simulation
from softsim_core.values import Box

PRESET = "Dragon Skin 10 MEDIUM"
POISSON = {1: 0.45, 2: 0.49}
"""By the order of the cells: linear ones lock at more."""
STIFFNESS_FACTOR = 1.75
"""As measured for that elastomer; its table says too little."""
DENSITY = 1070.0
"""In [kg/m^3]."""
DT = 0.01
_UNEVEN = 2.5e-3  # of the diagonal: how uneven a flat face may be after meshing
_WARM, _TIMED = 3, 11


def lowest_face(points: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Box:
    """A slab around the lowest nodes of a part: thick enough that it holds an area and not a tip.

    Args:
        points: Nodes in [m], shape (n, 3).
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    share = min(max(0.01, _UNEVEN * float(np.linalg.norm(size)) / float(size[2])), 0.2)
    while share < 0.2:
        chosen = points[points[:, 2] <= low[2] + share * size[2]]
        if len(chosen) > 3 and np.ptp(chosen[:, :2], axis=0).min() > 0.05 * size[:2].min():
            break
        share *= 1.5
    middle = 0.5 * (low + high)
    height = share * float(size[2])
    return Box(
        center=(float(middle[0]), float(middle[1]), float(low[2])),
        size=(1.1 * float(size[0]), 1.1 * float(size[1]), 2.0 * height),
    )


def held_part(mesh: TetMesh) -> SceneDescription:
    """A scene of the part alone, in SI units, z up."""
    body = BodyDescription(
        name="part",
        mesh=mesh,
        material=MaterialDescription(
            preset=PRESET, stiffness_factor=STIFFNESS_FACTOR, poisson_ratio=POISSON[mesh.order]
        ),
        density=DENSITY,
    )
    base = AttachmentDescription(name="base", body="part", to="world", box=lowest_face(mesh.points))
    solver = SolverSettings(rayleigh_stiffness=0.01)
    return SceneDescription(name="part", dt=DT, bodies=(body,), attachments=(base,), solver=solver)


def step_time(mesh: TetMesh) -> float:
    """Median time in [s] of a step."""
    simulation = Simulation(held_part(mesh))
    times = []
    for step in range(_WARM + _TIMED):
        start = perf_counter()
        simulation.step()
        if step >= _WARM:
            times.append(perf_counter() - start)
    return float(np.median(times))
