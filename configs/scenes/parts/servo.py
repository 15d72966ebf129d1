"""The servo alone: it swings with angle = cos(2 pi f) rad, f running from 0 to 1 in 10 s, in a loop."""

import math

from softsim_core import Scene
from softsim_core.robots import servo


def create_scene(scene: Scene) -> None:
    """One servo, moved by an animation."""
    scene.name = "servo"
    scene.add(servo("servo_0", horn_length=0.025))

    def swing(simulation, factor):
        simulation.command([math.cos(2.0 * math.pi * factor)])

    scene.animate(swing, duration=10.0, mode="loop")
