"""`Keyboard`: the keys of one user interface, from a press to the client's action."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from rclpy.node import Node
from std_msgs.msg import String

from softsim_core.scene import Action
from softsim_node import EVERY_ONE, LiveParameters, declare, parameter, parameter_probe
from softsim_ros.client import RobotClient
from softsim_ros.keys.press import (
    GOAL_STEP_M,
    REPEAT_INTERVAL_S,
    CallAction,
    KeyAction,
    KeyPress,
    KeyState,
    MoveGoal,
    Quit,
    SetReference,
    press,
)

DEFAULT_ROBOT: Final = "tripod"


@dataclass(frozen=True, kw_only=True)
class KeySettings:
    """Values of the parameters."""

    robot: str = parameter(
        DEFAULT_ROBOT, "Name or path of the robot whose keys and joints are used", fixed=True
    )
    repeat_interval: float = parameter(
        REPEAT_INTERVAL_S, "Shortest time between two steps of one held key", unit="s", within=(0.02, 2.0)
    )
    goal_step: float = parameter(
        GOAL_STEP_M, "How far a key moves the goal of inverse control", unit="m", within=(1e-5, 0.05)
    )


def requested_robot(node_name: str) -> str:
    """Return the parameter `robot` given to this process.

    It is read before the node is created, since the node takes its namespace from it.
    """
    with parameter_probe(node_name, namespace=DEFAULT_ROBOT) as probe:
        return declare(probe, KeySettings()).robot


class Keyboard:
    """Keys of a user; each is also published on the topic `keys`, for the scene's own functions.

    Declares the node's parameters `KeySettings`.

    Args:
        node: The node of the user interface.
        say: Called with a message for the user.

    Attributes:
        state: State of the keys.
        quit_requested: Whether a key has requested to quit.
    """

    def __init__(self, node: Node, client: RobotClient, say: Callable[[str], None]) -> None:
        self._client, self._say = client, say
        self.state, self.quit_requested = KeyState(), False
        self._keys = node.create_publisher(String, "keys", EVERY_ONE)
        self._settings = LiveParameters(node, KeySettings(robot=client.robot.name))
        self._actions: Mapping[Action, Callable[[], None]] = {
            "start": client.simulator.start,
            "reset": client.simulator.reset,
            "pause": client.simulator.toggle_pause,
            "inverse": client.inverse.toggle,
            "send": client.bridge.toggle,
            "e_stop": client.bridge.e_stop,
            "clear_e_stop": client.bridge.clear_e_stop,
        }

    def press(self, key: KeyPress, now: float) -> None:
        """Run the action of a key without blocking; `now` is a steady clock in [s]."""
        self._keys.publish(String(data=key.name))
        client, settings = self._client, self._settings.values
        self.state, action, message = press(
            self.state, client.robot, client.state, key, now, settings.repeat_interval, settings.goal_step
        )
        if message:
            self._say(message)
        if action is not None:
            self._carry_out(action)

    def click(self, name: str) -> None:
        """Run the action of a clicked button; it acts at each click, since no key is held down."""
        pressed_at = {key: at for key, at in self.state.pressed_at.items() if key != name}
        self.state = replace(self.state, pressed_at=pressed_at)
        self.press(KeyPress(name), time.monotonic())

    def press_with_ctrl(self, name: str) -> None:
        """Press a key with Ctrl; a key that is held down repeats at a limited rate."""
        self.press(KeyPress(name, ctrl=True), time.monotonic())

    def _carry_out(self, action: KeyAction) -> None:
        if isinstance(action, Quit):
            self.quit_requested = True
        elif isinstance(action, CallAction):
            self._actions[action.action]()
        elif isinstance(action, MoveGoal):
            self._client.inverse.move_goal(action.shift)
        elif isinstance(action, SetReference):
            self._client.closed_loop.refer(action.reference)
        else:
            self._client.joints.apply_request(action)
