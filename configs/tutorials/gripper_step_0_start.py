"""Cable gripper tutorial, last step, start: the gripper of step 5, with nothing to grasp."""

from softsim_core import KeyBinding, Scene, SolverSettings
from softsim_core.robots import cable_gripper


def create_scene(scene: Scene) -> None:
    """Write here: a floor and a cube, by rigid_thing(...), and contact settings with friction."""
    scene.name = "cable_gripper"
    scene.solver = SolverSettings(rayleigh_stiffness=0.01)
    scene.add(cable_gripper())
    cables, step = tuple(f"finger_{i}_cable" for i in (1, 2, 3)), 0.001
    scene.keys = {
        "plus": KeyBinding(joints=cables, by=step, help="close"),
        "minus": KeyBinding(joints=cables, by=-step, help="open"),
        "up": KeyBinding(joints=("vertical",), by=step, help="up"),
        "down": KeyBinding(joints=("vertical",), by=-step, help="down"),
    }
