"""Tripod tutorial, step 4-1, start: the silicone piece at the height of the arms, held at its centre."""

from softsim_core import Scene
from softsim_core.robots import fixing_box, tripod_silicone


def create_scene(scene: Scene) -> None:
    """Write here: three arms, by tripod(...) instead of tripod_silicone(), and a move_all that turns them."""
    scene.add(tripod_silicone("low"))
    scene.add(fixing_box("fixing_box", "silicone", center=(0.0, 0.0, 0.0275), size=(0.011, 0.011, 0.011)))
