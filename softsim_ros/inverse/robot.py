"""What nodes that give goals need to know of a robot: its name, where its effector rests, its frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core import SceneDescription
from softsim_core.arrays import Array
from softsim_core.errors import CommandError, SceneError, listing
from softsim_ros.simulator.parameters import declare_robot

WORLD = "world"


def robot_parameter(name: str, context: Context | None, overrides: Sequence[Parameter]) -> str:
    """The parameter `robot` of the command line, needed before the node `name`: it names the namespace."""
    node = Node(
        name,
        context=context,
        parameter_overrides=list(overrides),
        start_parameter_services=False,
        enable_rosout=False,
        enable_logger_service=False,
    )
    try:
        return declare_robot(node)
    finally:
        node.destroy_node()


def effector_rest(scene: SceneDescription) -> Array:
    """Position of the effector in [m] on the robot at rest, shape (3,).

    Raises:
        SceneError: the robot has no effector.
    """
    for attachment in scene.attachments:
        if attachment.name == scene.effector:
            return np.array(attachment.frame.translation)
    raise SceneError(f"{scene.name} has no effector: add `effector: NAME` of a free attachment to its file")


def check_frame(what: str, frame: str, robot: str) -> None:
    """Refuse a message in a frame that is neither the world nor the robot's base, which coincide.

    Raises:
        CommandError: names what is allowed.
    """
    allowed = (WORLD, f"{robot}_base")
    if frame not in allowed:
        raise CommandError(
            f"{what} refused: unknown frame_id {frame!r}; allowed: {listing(allowed)}; nothing was changed"
        )
