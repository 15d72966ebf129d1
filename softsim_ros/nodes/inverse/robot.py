"""Properties of a robot that senders of goals need: rest position of its effector, its frames."""

from __future__ import annotations

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import Array, CommandError, SceneError, listing
from softsim_core.scene.building import with_rest_frames
from softsim_core.scene.io import shorten
from softsim_node import WORLD, RobotFrames


def effector_rest(robot: RobotDescription) -> Array:
    """Return the position of the effector in [m] on the robot at rest, shape (3,).

    Raises:
        SceneError: the robot has no effector.
    """
    for attachment in with_rest_frames(robot.scene).attachments:
        if attachment.name == robot.scene.effector and attachment.frame is not None:
            return np.array(attachment.frame.translation)
    raise SceneError(f"{robot.name} has no effector: add `effector: NAME` of a free attachment to its file")


def world_frames(frames: RobotFrames) -> tuple[str, str]:
    """Return the allowed frames of goals: the world, and the robot's base, which is at the world's origin."""
    return (WORLD, frames.base)


def check_frame(what: str, frame: str, frames: RobotFrames) -> None:
    """Refuse a message in a frame that is not one of `world_frames`.

    Raises:
        CommandError: lists the allowed frames.
    """
    allowed = world_frames(frames)
    if frame not in allowed:
        raise CommandError(
            f"{what} refused: unknown frame_id {shorten(frame)!r}; allowed: {listing(allowed)}"
        )
