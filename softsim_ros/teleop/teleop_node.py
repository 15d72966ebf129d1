"""ROS node `teleop`: the keys of a terminal drive a robot's client, whose state goes on the display."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from softsim_core.scene import RobotDescription, load_scene
from softsim_ros.client.log import Warnings
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.keys.keyboard import Keyboard
from softsim_ros.keys.names import KeyPress
from softsim_ros.keys.table import unknown_keys
from softsim_ros.runtime import ClosableNode, declare_text, parameter_probe, ready_callbacks, run_node
from softsim_ros.teleop.display import View
from softsim_ros.teleop.held_output import HeldOutput
from softsim_ros.teleop.loop import run_teleop
from softsim_ros.teleop.terminal import RawTerminal

DEFAULT_ROBOT = "tripod"


class Teleop(ClosableNode):
    """Thin: a client of the robot, a keyboard that drives it, and the newest sentence for the person.

    Args:
        robot: Joints, limits, poses and keys.
        **node_options: Passed on to rclpy's Node; without a namespace there, the robot's name is used (a
            remapping on the command line wins over both).

    Attributes:
        client: The robot.
        keyboard: What its keys do.
    """

    def __init__(self, robot: RobotDescription, **node_options: Any) -> None:
        super().__init__("teleop", **{"namespace": robot.name, **node_options})
        declare_text(self, "robot", robot.name, "name or path of the robot whose keys and joints are used")
        self._message = unknown_keys(robot) or ""
        self.client = RobotClient(self, robot, self.set_status)
        self.keyboard = Keyboard(self, self.client, self.set_status)
        self._warnings = Warnings(self, self.set_status)

    @property
    def quit_requested(self) -> bool:
        """Whether a key has asked to end."""
        return self.keyboard.quit_requested

    def set_status(self, message: str) -> None:
        """Show one sentence."""
        self._message = message

    def handle_key(self, key: KeyPress, now: float) -> None:
        """Do what a key asks for, without waiting for anything; `now` is a steady clock in [s]."""
        self.keyboard.press(key, now)

    def view(self, now: float) -> View:
        """What the display shows at `now`, steady clock in [s]."""
        client = self.client
        return View(client.robot, client.state, self.keyboard.state, self._message, now, self.get_namespace())


def requested_robot() -> str:
    """The parameter `robot` given to this process, read before the node takes its namespace from it."""
    with parameter_probe("teleop", namespace=DEFAULT_ROBOT) as probe:
        return declare_text(probe, "robot", DEFAULT_ROBOT, "name or path of the robot")


def drive(node: Teleop) -> None:
    """Keys and display in this terminal until a person or a signal ends it.

    SIGINT and SIGTERM are rclpy's: they shut the context down, and the loop ends in order.

    Raises:
        NoTerminalError: this terminal cannot be used.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        with HeldOutput(), RawTerminal(signals=(signal.SIGHUP,)) as terminal:
            run_teleop(node, terminal, lambda: ready_callbacks(executor))
    finally:
        executor.shutdown(timeout_sec=0)


def main(args: Sequence[str] | None = None) -> int:
    """Run the teleop in this terminal; returns the exit code."""
    return run_node(lambda: Teleop(load_scene(requested_robot())), args, drive)


if __name__ == "__main__":
    sys.exit(main())
