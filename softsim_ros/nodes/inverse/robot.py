"""What nodes that give goals need to know of a robot: where its effector rests, its frames."""

from __future__ import annotations

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base.arrays import Array
from softsim_core.base.errors import CommandError, SceneError, listing
from softsim_core.scene.building.builder import with_rest_frames
from softsim_core.scene.io.catalog import shortened
from softsim_node.frames import WORLD, RobotFrames


def effector_rest(robot: RobotDescription) -> Array:
    """Position of the effector in [m] on the robot at rest, shape (3,).

    Raises:
        SceneError: the robot has no effector.
    """
    for attachment in with_rest_frames(robot.scene).attachments:
        if attachment.name == robot.scene.effector and attachment.frame is not None:
            return np.array(attachment.frame.translation)
    raise SceneError(f"{robot.name} has no effector: add `effector: NAME` of a free attachment to its file")


def world_frames(frames: RobotFrames) -> tuple[str, str]:
    """Frames a goal may be in: the world, and the robot's base, which stands in the world's origin."""
    return (WORLD, frames.base)


def check_frame(what: str, frame: str, frames: RobotFrames) -> None:
    """Refuse a message in a frame that is not one of `world_frames`.

    Raises:
        CommandError: names what is allowed.
    """
    allowed = world_frames(frames)
    if frame not in allowed:
        raise CommandError(
            f"{what} refused: unknown frame_id {shortened(frame)!r}; allowed: {listing(allowed)}"
        )
