"""The cable finger alone: its cable is pulled until the notches close, and let go, in a loop."""

from softsim_core import Scene, SolverSettings
from softsim_core.robots import cable_finger


def create_scene(scene: Scene) -> None:
    """One finger, moved by an animation."""
    scene.name = "cable_finger"
    scene.solver = SolverSettings(rayleigh_stiffness=0.01)
    scene.add(cable_finger("finger", pull_point=(0.003, 0.0105, 0.0125)))

    def pull(simulation, factor):
        simulation.command([0.035 * factor])

    scene.animate(pull, duration=2.0, mode="pingpong")
