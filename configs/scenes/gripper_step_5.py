"""Cable gripper tutorial, step 5: the three fingers on their slides, without floor and cube."""

from softsim_core import KeyBinding, Scene, SolverSettings
from softsim_core.robots import cable_gripper


def create_scene(scene: Scene) -> None:
    """Fingers, slides and the keys that move them by a millimetre."""
    scene.solver = SolverSettings(rayleigh_stiffness=0.01)
    scene.add(cable_gripper())
    cables, step = tuple(f"finger_{i}_cable" for i in (1, 2, 3)), 0.001
    scene.keys = {
        "plus": KeyBinding(joints=cables, by=step, help="close"),
        "minus": KeyBinding(joints=cables, by=-step, help="open"),
        "up": KeyBinding(joints=("vertical",), by=step, help="up"),
        "down": KeyBinding(joints=("vertical",), by=-step, help="down"),
        "left": KeyBinding(joints=("sideways",), by=step, help="to +y"),
        "right": KeyBinding(joints=("sideways",), by=-step, help="to -y"),
    }
