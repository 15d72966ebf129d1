"""What the controller hears of the robot it drives: joints, bases, effector; the newest of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import Pose, quaternion_of, rotation_exp, rotation_log, rotation_of
from softsim_core.scene.joint import JointDescription

Feedback: TypeAlias = Literal["none", "effector_pose", "imu"]
FEEDBACKS: Final[tuple[Feedback, ...]] = ("none", "effector_pose", "imu")

SILENT_AFTER_S: Final = 1.0
"""Joints not heard of for this long, in [s], have stopped."""

FEEDBACK_WITHIN_S: Final = 0.2
"""A measured pose older than this, in [s], corrects nothing."""

FOLLOWS_WITHIN: Final = 0.1
"""Joints follow when this near to the command: a part of their range, or of 1 rad or m without one."""


@dataclass(frozen=True, slots=True)
class Plant:
    """The robot as heard of at some time; immutable.

    Attributes:
        joints: Measured joint positions in [rad] or [m], efforts where these are commanded, shape (j,); None
            before the first message.
        joints_at: When, steady clock in [s].
        base_shift: Shift in [m] of the joint bases as the simulator says; None: nobody says.
        effector: Measured pose of the effector; None before the first message.
        effector_at: When, in [s].
        imu: Measured orientation, quaternion (x, y, z, w); None before the first message.
        imu_at: When, in [s].
    """

    joints: Array | None = None
    joints_at: float = -math.inf
    base_shift: float | None = None
    effector: Pose | None = None
    effector_at: float = -math.inf
    imu: Array | None = None
    imu_at: float = -math.inf

    def with_joints(self, positions: Array, now: float) -> Plant:
        """The plant after a measurement of its joints; one that is not finite is not used."""
        return replace(self, joints=positions, joints_at=now) if np.isfinite(positions).all() else self

    def with_base_shift(self, shift: float) -> Plant:
        """The plant after the simulator said where its joint bases are, in [m]."""
        return replace(self, base_shift=shift)

    def with_effector(self, pose: Pose, now: float) -> Plant:
        """The plant after a measurement of its effector at `now` [s]."""
        return replace(self, effector=pose, effector_at=now)

    def with_imu(self, quaternion_xyzw: Array, now: float) -> Plant:
        """The plant after a measurement of the effector's orientation at `now` [s]."""
        return replace(self, imu=quaternion_xyzw, imu_at=now)

    def is_silent(self, now: float) -> bool:
        """Whether the joints were not heard of lately, at `now` in [s]."""
        return now - self.joints_at > SILENT_AFTER_S

    def measured_pose(self, feedback: Feedback, model: Pose | None, now: float) -> Pose | None:
        """What corrects the model, or None where nothing fresh is known.

        Args:
            feedback: Where it comes from. An IMU tells the tilt only: position and heading are the model's.
            model: The model's pose.
            now: Steady clock in [s].
        """
        if feedback == "effector_pose" and now - self.effector_at <= FEEDBACK_WITHIN_S:
            return self.effector
        if feedback == "imu" and now - self.imu_at <= FEEDBACK_WITHIN_S and model is not None:
            assert self.imu is not None
            return _with_tilt(model, self.imu)
        return None


def off_command(joints: Sequence[JointDescription], positions: Array, command: Array) -> list[str]:
    """Names of the joints that are not near their command.

    Args:
        joints: Their limits.
        positions: Measured, in [rad] or [m], shape (j,).
        command: Sent, same shape and unit.
    """
    off = []
    for joint, position, wanted in zip(joints, positions, command, strict=True):
        span = joint.limits.upper - joint.limits.lower
        reach = FOLLOWS_WITHIN * (span if math.isfinite(span) else 1.0)
        if abs(position - wanted) > reach:
            off.append(joint.name)
    return off


def _with_tilt(model: Pose, measured: Array) -> Pose:
    """The model's pose, tilted as measured; the turn about the world's vertical stays the model's."""
    rotation = rotation_of(model.quaternion_xyzw)
    error = rotation_log(rotation_of(measured) @ rotation.T)
    error[2] = 0.0
    return Pose(model.position, quaternion_of(rotation_exp(error) @ rotation))
