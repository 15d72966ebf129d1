"""Whether the robot still follows: silent or stuck joints hold the command until they are back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from softsim_core.arrays import Array
from softsim_core.errors import listing
from softsim_core.scene.joint import JointDescription
from softsim_ros.inverse.plant import SILENT_AFTER_S, Plant, off_command

STUCK_AFTER_S: Final = 1.0
"""Joints away from their command for this long, in [s], do not follow."""


class Following:
    """Watches the joints of a robot under control.

    Args:
        joints: Their limits.
        now: Steady clock in [s].
    """

    def __init__(self, joints: Sequence[JointDescription], now: float) -> None:
        self._joints = joints
        self._followed_at = now
        self._stuck = ""

    def trouble(self, plant: Plant, command: Array | None, now: float) -> str:
        """Why the command must be held at `now`; empty while the robot follows.

        Args:
            plant: What is heard of the robot.
            command: The newest command in [rad] or [m], shape (j,); None before the first.
            now: Steady clock in [s].
        """
        if plant.is_silent(now) or plant.joints is None:
            self._followed_at = now  # once heard of again they get their time to follow
            return f"holding: no joint states for more than {SILENT_AFTER_S:g} s; is the robot running?"
        off = [] if command is None else off_command(self._joints, plant.joints, command)
        if not off:
            self._followed_at, self._stuck = now, ""
        elif self._stuck or now - self._followed_at > STUCK_AFTER_S:
            self._stuck = f"holding: {listing(off)} not following the command; is the robot stopped?"
        return self._stuck


def has_moved(shift: float, plant: Plant) -> bool:
    """Whether the joint bases are no longer at the `shift` [m] that the model was started with."""
    return plant.base_shift is not None and not math.isclose(plant.base_shift, shift, abs_tol=1e-6)
