"""Tripod tutorial, step 4-2: the ends of the silicone are rigid, but not attached to the arms: it falls.

The arms move from 0 to -45 deg in 1 s.
"""

import math

from softsim_core import JointLimits, Scene
from softsim_core.robots import move_all, tripod


def create_scene(scene: Scene) -> None:
    """Arms, body with three free rigid ends, scripted move."""
    scene.add(tripod(limits=JointLimits(), tips="free", centre_radius=None))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
