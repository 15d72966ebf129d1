"""The elastic body alone: the Tripod's silicone piece, held by a box at its centre, sags under its weight."""

from softsim_core import Scene
from softsim_core.robots import fixing_box, tripod_silicone


def create_scene(scene: Scene) -> None:
    """A silicone piece and a box that holds the edge of its hole."""
    scene.name = "elastic_body"
    scene.add(tripod_silicone("low"))
    scene.add(fixing_box("hold", "silicone", center=(0.0, 0.0, 0.0275), size=(0.011, 0.011, 0.011)))
