"""Tripod tutorial, step 5, start: the robot with its effector, and no keys that move it."""

from softsim_core import JointLimits, Scene, SolverSettings
from softsim_core.robots import tripod


def create_scene(scene: Scene) -> None:
    """Write here: scene.keys, a named pose and the start animation."""
    scene.name = "tripod"
    scene.solver = SolverSettings(rayleigh_stiffness=0.005)
    scene.add(tripod(limits=JointLimits()))
