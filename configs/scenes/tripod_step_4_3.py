"""Tripod tutorial, step 4-3: the rigid ends of the silicone move with the arms, from 0 to -45 deg in 1 s."""

import math

from softsim_core import JointLimits, Scene, SolverSettings
from softsim_core.robots import move_all, tripod


def create_scene(scene: Scene) -> None:
    """Arms, body with its ends attached to them, scripted move."""
    scene.solver = SolverSettings(rayleigh_stiffness=0.05)
    scene.add(tripod(limits=JointLimits(), centre_radius=None))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
