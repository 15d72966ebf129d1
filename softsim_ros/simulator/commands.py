"""Command messages as checked values: what is wrong is refused here and never reaches the physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.mechanics.limits import check_command


def position_command(message: Float64MultiArray, joints: Sequence[str]) -> Array:
    """Joint positions in [rad] or [m], shape (len(joints),).

    Raises:
        CommandError: wrong length, or a value that is not a finite number.
    """
    return np.array(check_command(message.data, joints))


def trajectory_command(message: JointTrajectoryMessage, joints: Sequence[str]) -> JointTrajectory:
    """The way points of a message; they start when it arrives, its time stamp is not used.

    Raises:
        CommandError: unknown joints, wrong lengths, times that do not grow, values that are not finite.
    """
    for index, point in enumerate(message.points):
        if len(point.positions) != len(message.joint_names):
            raise CommandError(
                f"trajectory refused: point {index} has {len(point.positions)} positions for "
                f"{len(message.joint_names)} joints; nothing was moved"
            )
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points]
    positions = np.array([point.positions for point in message.points], dtype=float)
    trajectory = JointTrajectory(
        message.joint_names, times, positions.reshape(len(times), len(message.joint_names))
    )
    trajectory.check_joints(joints)
    return trajectory
