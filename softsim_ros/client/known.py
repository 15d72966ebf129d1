"""What is known of a robot, in one place: the parts of a client write it, everybody reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.state import RobotState

Watcher = Callable[[RobotState], None]
"""Called with the state after every change, in the thread that serves the node."""


class Known:
    """The robot's description and its newest state.

    Args:
        robot: Joints, limits and poses.
        say: Called with every sentence for the person.

    Attributes:
        robot: Another one after the simulator has loaded another scene.
        state: Replaced whole, never changed.
        watchers: Told of every change.
    """

    def __init__(self, robot: RobotDescription, say: Callable[[str], None]) -> None:
        self.robot, self.say = robot, say
        self.state = RobotState()
        self.watchers: list[Watcher] = []

    def put(self, state: RobotState) -> None:
        """Keep a newer state."""
        if state is not self.state:
            self.state = state
            for watcher in self.watchers:
                watcher(state)

    def change(self, **values: Any) -> None:
        """Keep the state with other values of some attributes."""
        self.put(replace(self.state, **values))
