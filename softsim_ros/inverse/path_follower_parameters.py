"""The path follower's parameters."""

from __future__ import annotations

from typing import Final

from rclpy.node import Node

from softsim_ros.inverse.parameters import TASKS
from softsim_ros.runtime import declare_number, declare_switch, declare_text

STARTS: Final = ("rest", "measured")
AUTO: Final = "auto"
LEAVE: Final = "leave"


def declare_parameters(node: Node) -> None:
    """Declare all parameters but `robot`.

    Raises:
        ParameterError: a value given at start is not allowed.
    """
    declare_text(
        node,
        "file",
        "",
        "Path: a maze plan (.json) or timed poses (.csv); a name in configs/paths, at the start also a file",
        read_only=False,
    )
    declare_text(
        node,
        "start_from",
        STARTS[0],
        "Where a maze plan begins: at the effector's place on the robot at rest, or where it is measured",
        choices=STARTS,
    )
    declare_text(
        node,
        "task",
        AUTO,
        "What of a goal the inverse controller follows from the start of a path on; auto: height_tilt for "
        "a maze plan, else what the robot's file says",
        choices=(AUTO, LEAVE, *TASKS),
    )
    declare_switch(node, "loop", False, "Begin again at the end")
    declare_number(node, "speed", 1.0, "Seconds of the path a second", 0.0, 100.0)
    declare_switch(node, "autostart", False, "Start as soon as the node runs, or a path arrives")
    declare_switch(node, "enable_inverse", True, "Switch the inverse controller on at the start of a path")
    declare_switch(
        node, "start_with_inverse", False, "Start when the inverse controller is switched on (key I)"
    )
