"""The path follower's parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from softsim_node.parameters import parameter
from softsim_ros.inverse.parameters import TASKS
from softsim_ros.robot_node import RobotSettings

STARTS: Final = ("rest", "measured")
AUTO: Final = "auto"
LEAVE: Final = "leave"


@dataclass(frozen=True, kw_only=True)
class FollowerSettings(RobotSettings):
    """Values of the parameters."""

    file: str = parameter(
        "",
        "Path: a maze plan (.json) or timed poses (.csv); a name in configs/paths, at the start also a file",
    )
    start_from: str = parameter(
        STARTS[0],
        "Where a maze plan begins: at the effector's place on the robot at rest, or where it is measured",
        choices=STARTS,
        fixed=True,
    )
    task: str = parameter(
        AUTO,
        "What of a goal the inverse controller follows from the start of a path on; auto: height_tilt for "
        "a maze plan, else what the robot's file says",
        choices=(AUTO, LEAVE, *TASKS),
        fixed=True,
    )
    loop: bool = parameter(False, "Begin again at the end")
    speed: float = parameter(1.0, "Seconds of the path per second", within=(0.0, 100.0))
    autostart: bool = parameter(False, "Start as soon as the node runs, or a path arrives")
    enable_inverse: bool = parameter(True, "Switch the inverse controller on at the start of a path")
    start_with_inverse: bool = parameter(False, "Start when the inverse controller is switched on (key I)")
