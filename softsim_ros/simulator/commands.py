"""Command messages as checked values: what is wrong is refused here and never reaches the physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.mechanics.limits import check_command
from softsim_core.mechanics.named_command import (
    check_age,
    check_named_command,
    check_positions_only,
    says_something,
)
from softsim_core.scene.catalog import MOST_NAMES, names_up_to

MOST_POINTS: Final = 10_000
"""A trajectory of more way points is refused: every one of them costs time between two steps."""

FARTHEST_START_S: Final = 3600.0
"""A trajectory that begins later than so many seconds from now was stamped by another clock."""

LATE_S: Final = 0.5
"""A trajectory that is over for no longer than this in [s] still goes to its end."""


def position_command(message: Float64MultiArray, joints: Sequence[str]) -> Array:
    """Joint positions in [rad] or [m], shape (len(joints),).

    Raises:
        CommandError: wrong length, or a value that is not a finite number.
    """
    return np.array(check_command(message.data, joints))


def seconds(stamp: Time) -> float:
    """A time stamp in [s]."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def named_command(message: JointState, joints: Sequence[str], now_s: float) -> dict[str, float]:
    """Positions in [rad] or [m] of the joints that a message names, those with NaN left out.

    Args:
        message: In any order, of some joints or all.
        joints: Joints that there are.
        now_s: The time now in [s], on the clock of the stamps.

    Raises:
        CommandError: it is too old, says more than positions, or what `check_named_command` refuses.
    """
    check_age(seconds(message.header.stamp), now_s)
    check_positions_only(message.velocity, message.effort)
    return check_named_command(message.name, message.position, joints)


def trajectory_delay(message: JointTrajectoryMessage, now_s: float) -> float:
    """In how many seconds a trajectory begins by its time stamp, < 0 where it has begun; 0 without a stamp.

    Raises:
        CommandError: it is over already, or too far ahead.
    """
    begin = seconds(message.header.stamp)
    delay = begin - now_s if begin else 0.0
    if delay > FARTHEST_START_S:
        raise CommandError(
            f"trajectory refused: by its stamp it begins in {delay:.0f} s; allowed are {FARTHEST_START_S:g}; "
            "use one clock (use_sim_time), or stamp it 0 for now; nothing was moved"
        )
    if begin and message.points and delay + seconds(message.points[-1].time_from_start) < -LATE_S:
        raise CommandError(
            f"trajectory refused: by its stamp it began {-delay:.1f} s ago and is over; use one clock "
            "(use_sim_time), or stamp it 0 for now; nothing was moved"
        )
    return delay


def trajectory_command(message: JointTrajectoryMessage, joints: Sequence[str]) -> JointTrajectory:
    """The way points of a message, see `JointTrajectory`.

    Raises:
        CommandError: unknown joints, too many of them or of points, wrong lengths, times that do not grow,
            values that are not finite, slopes at some points only, or efforts.
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
    if any(says_something(point.effort) for point in message.points):
        raise CommandError(
            "trajectory refused: efforts are not obeyed; leave them empty, or fill them with NaN or 0; "
            "nothing was moved"
        )
    for index, point in enumerate(message.points):
        if len(point.positions) != len(message.joint_names):
            raise CommandError(
                f"trajectory refused: point {index} has {len(point.positions)} positions for "
                f"{len(message.joint_names)} joints; nothing was moved"
            )
    times = [seconds(point.time_from_start) for point in message.points]
    positions = np.array([point.positions for point in message.points], dtype=float)
    trajectory = JointTrajectory(
        message.joint_names,
        times,
        positions.reshape(len(times), len(message.joint_names)),
        _slopes(message, "velocities"),
        _slopes(message, "accelerations"),
    )
    trajectory.check_joints(joints)
    return trajectory


def _slopes(message: JointTrajectoryMessage, field: str) -> Array | None:
    """Velocities or accelerations of all way points, shape (points, joints); None where none has them.

    Raises:
        CommandError: only some have them, or not one for each joint.
    """
    lengths = [len(getattr(point, field)) for point in message.points]
    if not any(lengths):
        return None
    if lengths != [len(message.joint_names)] * len(lengths):
        raise CommandError(
            f"trajectory refused: give {field} of every joint at every point, or none; nothing was moved"
        )
    values = np.array([getattr(point, field) for point in message.points], dtype=float)
    return None if np.isnan(values).all() else values
