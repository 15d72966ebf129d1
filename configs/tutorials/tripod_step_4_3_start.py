"""Tripod tutorial, step 4-3, start: step 4-2, rigid ends that nothing holds."""

import math

from softsim_core import JointLimits, Scene
from softsim_core.robots import move_all, tripod


def create_scene(scene: Scene) -> None:
    """Write here: let the arms hold the ends, and give the solver some damping."""
    scene.add(tripod(limits=JointLimits(), tips="free", centre_radius=None))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
