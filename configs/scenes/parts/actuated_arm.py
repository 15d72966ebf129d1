"""The actuated arm alone: it swings with angle = cos(2 pi f) rad, f running from 0 to 1 in 10 s, in a loop.

Two of them side by side show that a part can be used several times in one scene.
"""

import math

from softsim_core import Placement, Scene
from softsim_core.robots import actuated_arm


def create_scene(scene: Scene) -> None:
    """Two arms, moved in opposite senses by one animation."""
    scene.name = "actuated_arm"
    scene.add(actuated_arm("left", base=Placement(translation=(0.0, 0.03, 0.0))))
    scene.add(actuated_arm("right", base=Placement(translation=(0.0, -0.03, 0.0))))

    def swing(simulation, factor):
        angle = math.cos(2.0 * math.pi * factor)
        simulation.command([angle, -angle])

    scene.animate(swing, duration=10.0, mode="loop")
