"""Pose messages as checked poses: what is wrong is refused here, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import Quaternion as QuaternionMessage

from softsim_core.arrays import Array
from softsim_core.errors import CommandError, listing
from softsim_core.mechanics.pose import Pose
from softsim_core.scene.catalog import shortened

FARTHEST_M = 1000.0
"""A goal further from the origin than this, in [m], is none that somebody meant."""

NORM_TOLERANCE = 0.1
"""A quaternion whose length is further from 1 than this is no rotation somebody meant."""


def checked_pose(message: PoseStamped, frames: Sequence[str], what: str) -> Pose:
    """The pose that a message tells, in the world.

    Args:
        message: Position in [m] and quaternion; a quaternion of four zeros stands for no rotation.
        frames: Allowed frames; all of them coincide with the world.
        what: What the pose is, for the sentence of a refusal.

    Raises:
        CommandError: unknown frame, a position that is not finite or too far away, or no rotation.
    """
    frame = message.header.frame_id
    if frame not in frames:
        raise CommandError(
            f"{what} refused: unknown frame_id {shortened(frame)!r}; allowed: {listing(frames)}"
        )
    place = message.pose.position
    position = np.array([place.x, place.y, place.z])
    if not (np.abs(position) <= FARTHEST_M).all():  # also catches NaN
        raise CommandError(
            f"{what} refused: position {position.tolist()} is not finite or beyond {FARTHEST_M:g} m"
        )
    return Pose(position, unit_quaternion(message.pose.orientation, what))


def unit_quaternion(message: QuaternionMessage, what: str) -> Array:
    """Unit quaternion (x, y, z, w), shape (4,), of a message; four zeros stand for no rotation.

    Raises:
        CommandError: not finite, or not a rotation.
    """
    turn = np.array([message.x, message.y, message.z, message.w])
    if not turn.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    norm = float(np.linalg.norm(turn))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # also catches NaN
        raise CommandError(f"{what} refused: orientation {turn.tolist()} is no unit quaternion (x, y, z, w)")
    return np.asarray(turn / norm)
