"""Scenes with cables and contact, kept in motion around a state in which they pull and touch."""

from __future__ import annotations

import numpy as np

from softsim_core import Simulation
from softsim_core.arrays import Array
from softsim_core.scene import load_scene
from softsim_core.scene.description import Backend, SceneDescription

SCENES = ("cable_finger", "gripper_free", "gripper_grasp", "tripod_ball")
LIMITS = {"cable_finger": 0.2, "gripper_free": 0.8, "gripper_grasp": 2.5, "tripod_ball": 1.2}
"""Longest step in [ms] on a machine where the held body of the low mesh takes HELD_MS."""
HELD_MS = 0.17

CLOSED, LOWERED = 0.012, -0.050
"""Pull of the cables and height of the grasping gripper in [m]."""
LEAD_IN = {"cable_finger": 60, "gripper_free": 60, "gripper_grasp": 350, "tripod_ball": 150}
"""Steps to the state around which a scene is measured: the gripper has closed, the ball has come to rest."""


def describe_touching(scene: str) -> SceneDescription:
    """One of SCENES, on our own low meshes.

    Raises:
        SoftSimError: a file is missing or broken.
    """
    if scene == "gripper_free":
        return load_scene("cable_gripper", {"collisions": [], "rigid_bodies": []})
    return load_scene("cable_gripper" if scene == "gripper_grasp" else scene)


class TouchingScene:
    """A simulation that starts anew, now and then, from where it pulls and touches.

    Args:
        name: One of SCENES.
        description: The scene.
        backend: Implementation of the step that is measured.
    """

    def __init__(self, name: str, description: SceneDescription, backend: Backend) -> None:
        leader = Simulation(description)
        if description.start is not None:
            leader.start_animation()
        for step in range(LEAD_IN[name]):
            if description.start is None:
                leader.command(_pulled(leader, name, step / LEAD_IN[name]))
            leader.step()
        self.simulation = Simulation(description, backend)
        self._home, self._command = leader.snapshot(), leader.joint_targets
        self._random = np.random.default_rng(1)
        self.stir()

    def stir(self) -> None:
        """Back to where it started, with a command nearby."""
        self.simulation.restore(self._home)
        size = 0.02 if self.simulation.scene.start is not None else 1e-3  # rad, m
        self.simulation.command(self._command + self._random.uniform(-size, size, len(self._command)))


def _pulled(simulation: Simulation, name: str, share: float) -> Array:
    """Command at a share of the lead-in: first down, where there is a cube, then closed."""
    down = 0.4 if name == "gripper_grasp" else 0.0
    cables = [joint.cable for joint in simulation.model.joints]
    command = np.where(cables, CLOSED * max(0.0, (share - down) / (1.0 - down)), 0.0)
    if down:
        command[simulation.joint_names.index("vertical")] = LOWERED * min(1.0, share / down)
    return command
