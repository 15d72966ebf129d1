"""Command messages as checked values: what is wrong is refused here and never reaches the physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.mechanics.limits import check_command
from softsim_core.scene.catalog import MOST_NAMES, names_up_to

MOST_POINTS: Final = 10_000
"""A trajectory of more way points is refused: every one of them costs time between two steps."""


def position_command(message: Float64MultiArray, joints: Sequence[str]) -> Array:
    """Joint positions in [rad] or [m], shape (len(joints),).

    Raises:
        CommandError: wrong length, or a value that is not a finite number.
    """
    return np.array(check_command(message.data, joints))


def trajectory_command(message: JointTrajectoryMessage, joints: Sequence[str]) -> JointTrajectory:
    """The way points of a message; they start when it arrives, its time stamp is not used.

    Raises:
        CommandError: unknown joints, too many of them or of points, wrong lengths, times that do not grow,
            values that are not finite.
    """
    if len(message.joint_names) > len(joints):
        raise CommandError(
            f"trajectory refused: it names {len(message.joint_names)} joints of one with {len(joints)} "
            f"({names_up_to(MOST_NAMES, joints)}); nothing was moved"
        )
    if len(message.points) > MOST_POINTS:
        raise CommandError(
            f"trajectory refused: it has {len(message.points)} points; send at most {MOST_POINTS} at once; "
            "nothing was moved"
        )
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
