"""The cable finger below a knob, with notches of any depth, for studies: softsim optimise finger_notches."""

from softsim_core import Scene
from softsim_core.base import Box, Placement
from softsim_core.physics.mesh import Shape
from softsim_core.robots import cable_finger, finger, rigid_thing
from softsim_core.scene import CollisionDescription

DENSITY = 1070.0
"""Of the silicone in [kg/m^3]."""


def create_scene(scene: Scene, notch_depth: float = 0.010) -> None:
    """A finger with two notches of a depth in [m], 18.5 mm below a ball that is held."""
    silicone = {"mesh": finger(notch_depth=notch_depth), "surface": None}
    single = cable_finger("finger", pull_point=(0.003, 0.0105, 0.0125), collides=False)
    scene.add(single.with_bodies(**silicone, total_mass=None, density=DENSITY, mass_distribution="volume"))
    scene.add(rigid_thing("knob", Shape(sphere=0.010), Placement(translation=(0.0075, -0.085, 0.0285))))
    tip = Box(center=(0.0075, -0.091, 0.010), size=(0.016, 0.026, 0.012))
    scene.add(CollisionDescription(name="fingertip", body="finger", boxes=(tip,)))
    scene.gravity = (0.0, 0.0, -9.81)
