"""Time of a whole tick of inverse control: sensitivities, program and model step."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from softsim_core.inverse.controller import InverseController
from softsim_core.mechanics.pose import Pose
from softsim_core.scene.robot import RobotDescription

GOAL_SPREAD = 0.004
"""Half the range in [m] around the effector's place in the start pose from which goals are drawn."""


def can_control() -> bool:
    """Whether inverse control can run here: it needs daqp, and compiled steps to be worth measuring."""
    return bool(find_spec("daqp") and find_spec("numba"))


class MovingGoal:
    """Inverse control kept in motion: the goal jumps from place to place around the start pose."""

    def __init__(self, description: RobotDescription) -> None:
        self.controller = InverseController(replace(description, start=None), backend="numba")
        start = description.start
        if start is not None:
            self.controller.start(description.poses[start.pose], start.base_shift)
        self._home = self.controller.tick().model_pose
        self._random = np.random.default_rng(1)

    def stir(self) -> None:
        """Another goal."""
        shift = self._random.uniform(-GOAL_SPREAD, GOAL_SPREAD, 3)
        self.controller.set_goal(Pose(self._home.position + shift, self._home.quaternion_xyzw))
