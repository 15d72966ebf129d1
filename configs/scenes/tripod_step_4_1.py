"""Tripod tutorial, step 4-1: three arms beside a silicone piece that a box holds at its centre.

The arms move from 0 to -45 deg in 1 s; nothing connects them to the silicone yet.
"""

import math

from softsim_core import JointLimits, Scene
from softsim_core.robots import fixing_box, move_all, tripod


def create_scene(scene: Scene) -> None:
    """Arms, body, fixing box around the edge of the hole, scripted move."""
    scene.add(tripod(limits=JointLimits(), tips="none", centre_radius=None))
    scene.add(fixing_box("fixing_box", "silicone", center=(0.0, 0.0, 0.0275), size=(0.011, 0.011, 0.011)))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
