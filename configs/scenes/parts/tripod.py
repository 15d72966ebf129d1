"""The Tripod part alone: three servos and the silicone piece; the arms move from 0 to -45 deg in 1 s."""

import math

from softsim_core import JointLimits, Scene, SolverSettings
from softsim_core.robots import move_all, tripod


def create_scene(scene: Scene) -> None:
    """The robot, without the limits of the real servos, moved by an animation."""
    scene.name = "tripod"
    scene.solver = SolverSettings(rayleigh_stiffness=0.005)
    scene.add(tripod(limits=JointLimits()))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
