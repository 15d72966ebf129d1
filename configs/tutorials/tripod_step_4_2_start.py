"""Tripod tutorial, step 4-2, start: step 4-1, three arms beside a held silicone piece."""

import math

from softsim_core import JointLimits, Scene
from softsim_core.robots import fixing_box, move_all, tripod


def create_scene(scene: Scene) -> None:
    """Write here: tips="free" makes the ends rigid; take the fixing box away."""
    scene.add(tripod(limits=JointLimits(), tips="none", centre_radius=None))
    scene.add(fixing_box("fixing_box", "silicone", center=(0.0, 0.0, 0.0275), size=(0.011, 0.011, 0.011)))
    scene.add(move_all(-math.pi / 4.0, duration=1.0))
