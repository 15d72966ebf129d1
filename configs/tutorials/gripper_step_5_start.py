"""Cable gripper tutorial, step 5, start: one finger, from its ready-made part, hanging down."""

from softsim_core import KeyBinding, Placement, Scene, SolverSettings
from softsim_core.robots import cable_finger


def create_scene(scene: Scene) -> None:
    """Write here: cable_gripper() instead of one finger, and keys for three cables and two slides."""
    scene.name = "gripper_step_5"
    scene.solver = SolverSettings(rayleigh_stiffness=0.01)
    scene.add(cable_finger("finger_1", Placement(rotation_deg=(105.0, 0.0, 0.0)), (0.003, -0.017, 0.0105)))
    scene.keys = {
        "plus": KeyBinding(joints=("finger_1_cable",), by=0.001, help="close"),
        "minus": KeyBinding(joints=("finger_1_cable",), by=-0.001, help="open"),
    }
