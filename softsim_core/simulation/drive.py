"""The joints' drive: from accepted commands to where each joint is told to be at the end of every step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from softsim_core.actuation.animation import factor_at, is_over
from softsim_core.arrays import Array
from softsim_core.errors import CommandError, SceneError
from softsim_core.mechanics.limits import check_command
from softsim_core.scene.robot import RobotDescription

_IDLE = -1.0


class JointDrive:
    """Commands, limits and the start animation of a robot's joints.

    Attributes:
        targets: The last accepted command in [rad] or [m], shape (j,).
        positions: Where the joints are told to be now, on their way to the targets, shape (j,).
        base_shift: Shift in [m] of the joint bases along their slide axes.
        enforce_limits: Whether position and speed limits hold.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._rest = np.array([joint.rest for joint in robot.joints], dtype=float)
        self._speed = np.array([joint.limits.speed for joint in robot.joints], dtype=float)
        self.enforce_limits = robot.commands.enforce_limits
        self.reset()

    def reset(self) -> None:
        """Back to the rest positions; the start animation begins anew where the scene says so."""
        self.targets: Array = self._rest.copy()
        self.positions: Array = self._rest.copy()
        self.base_shift = 0.0
        self._started, self._animates_joints = _IDLE, True
        if self._robot.start is not None and self._robot.start.at_start:
            self._started = 0.0

    def command(self, values: Sequence[float]) -> None:
        """Set where the joints go; a running start animation lets go of them and only brings the bases home.

        Raises:
            CommandError: wrong length, not finite, or out of range in a scene that refuses; nothing changes.
        """
        accepted = check_command(values, self._robot.joint_names)
        if self.enforce_limits:
            for index, joint in enumerate(self._robot.joints):
                refuses = self._robot.commands.out_of_range == "refuse"
                if refuses and not joint.limits.allows(accepted[index]):
                    raise CommandError(
                        f"command {accepted[index]} for joint {joint.name} refused: allowed is "
                        f"[{joint.limits.lower}, {joint.limits.upper}]; nothing was moved"
                    )
                accepted[index] = joint.limits.clamp(accepted[index])
        self.targets = np.array(accepted, dtype=float)
        self._animates_joints = False

    def start(self, time: float) -> None:
        """Begin the robot's start animation at `time` [s], from the rest pose, whatever the pose is now.

        Raises:
            SceneError: the scene has none.
        """
        if self._robot.start is None:
            raise SceneError(f"scene {self._robot.name} has no start animation (key `start` of its file)")
        self._started, self._animates_joints = time, True

    def advance(self, time: float, dt: float) -> None:
        """Move `positions` on for the step of `dt` that begins at `time`, both in [s].

        The start animation is absolute and is not slowed by the speed limits.
        """
        start = self._robot.start
        if start is not None and self._started != _IDLE:
            elapsed = time - self._started
            factor = factor_at(elapsed, start.duration)
            self.base_shift = factor * start.base_shift
            if is_over(elapsed, start.duration):
                self._started = _IDLE
            if self._animates_joints:
                pose = np.array(self._robot.poses[start.pose])
                self.targets = self._rest + factor * (pose - self._rest)
                self.positions = self.targets.copy()
                return
        if self.enforce_limits:
            reach = self._speed * dt
            nearest = np.minimum(self.targets, self.positions + reach)
            self.positions = np.maximum(nearest, self.positions - reach)
        else:
            self.positions = self.targets.copy()

    def shift_bases(self, shift: float) -> None:
        """Place the joint bases `shift` [m] along their slide axes.

        Raises:
            CommandError: not a finite number.
        """
        if not math.isfinite(shift):
            raise CommandError(f"base_shift {shift} refused: expected a finite number of metres")
        self.base_shift = float(shift)

    def place(self, positions: Array, base_shift: float) -> None:
        """Stand at `positions` (j,) with the bases at `base_shift` [m]; a running start animation ends."""
        self.targets, self.positions = positions.copy(), positions.copy()
        self.base_shift = base_shift
        self._started = _IDLE

    def arrays(self) -> dict[str, Array]:
        """Everything a snapshot needs, by name."""
        return {
            "targets": self.targets,
            "positions": self.positions,
            "started": np.array([self._started]),
            "base_shift": np.array([self.base_shift]),
            "enforce_limits": np.array([float(self.enforce_limits)]),
            "animates_joints": np.array([float(self._animates_joints)]),
        }

    def take(self, arrays: Mapping[str, Array]) -> None:
        """Take back what `arrays` gave."""
        self.targets, self.positions = arrays["targets"].copy(), arrays["positions"].copy()
        self._started, self.base_shift = float(arrays["started"][0]), float(arrays["base_shift"][0])
        self.enforce_limits = bool(arrays["enforce_limits"][0])
        self._animates_joints = bool(arrays["animates_joints"][0])
