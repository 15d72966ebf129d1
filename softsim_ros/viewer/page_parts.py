"""What the page is made of besides its controls; each tab is given those parts that it needs."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_ros.client.log import RobotLog
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.keys.keyboard import Keyboard
from softsim_ros.viewer.drive_tab import Hint
from softsim_ros.viewer.edit_mode import EditMode
from softsim_ros.viewer.picture import Picture
from softsim_ros.viewer.pull import MousePull
from softsim_ros.viewer.spoken import Spoken
from softsim_ros.viewer.step_statistics import StepStatistics


@dataclass(frozen=True)
class PageParts:
    """The parts.

    Attributes:
        client: The robot.
        keyboard: Its keys.
        spoken: What was said to the person.
        picture: What is drawn.
        mouse: The spring of a pull.
        statistics: What the simulator tells of its steps.
        log: What the robot's nodes say.
        edit: The scene as it is proposed.
        hint: Words for the first minute.
        is_local: Whether only browsers of this machine see the page.
    """

    client: RobotClient
    keyboard: Keyboard
    spoken: Spoken
    picture: Picture
    mouse: MousePull
    statistics: StepStatistics
    log: RobotLog
    edit: EditMode
    hint: Hint
    is_local: bool
