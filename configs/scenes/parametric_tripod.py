"""The Tripod with arms of another width and thickness, for studies: softsim optimise tripod_arms."""

import numpy as np

from softsim_core import (
    AddedMassDescription,
    BodyDescription,
    JointLimits,
    MaterialDescription,
    Scene,
    Sphere,
    StartAnimation,
    TetMesh,
)
from softsim_core.robots import tripod, tripod_mesh

HEIGHT = 0.025
"""Of the lower face of the silicone in [m]."""

DENSITY = 1070.0
"""Of the silicone in [kg/m^3]."""


def create_scene(
    scene: Scene, half_width: float = 0.015, thickness: float = 0.005, payload: float = 0.02
) -> None:
    """A Tripod whose arms are twice `half_width` wide and `thickness` thick in [m].

    Its centre carries a payload in [kg]. The ends of the servos' arms hold up to 6 mm of thickness.
    """
    flat = tripod_mesh.tripod_silicone(half_width=half_width, thickness=thickness)
    silicone = BodyDescription(
        name="silicone",
        mesh=TetMesh(flat.points + np.array([0.0, 0.0, HEIGHT]), flat.tets, flat.name),
        material=MaterialDescription(young_modulus=250.0e3, poisson_ratio=0.45),
        density=DENSITY,
        added_masses=(
            AddedMassDescription(mass=payload, sphere=Sphere(center=(0.0, 0.0, 0.030), radius=0.0075)),
        ),
    )
    scene.add(tripod(silicone=silicone, limits=JointLimits(lower=-1.5, upper=-0.7, speed=3.5)))
    scene.gravity = (0.0, 0.0, -9.81)
    scene.poses["start"] = (-1.4965, -1.4965, -1.4965)
    scene.start = StartAnimation(pose="start", duration=0.2, base_shift=0.035)
