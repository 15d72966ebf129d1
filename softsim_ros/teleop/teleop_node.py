"""ROS node `teleop`: the keys of a terminal drive a robot's client, whose state goes on the display."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from softsim_core.scene import RobotDescription, load_scene
from softsim_node.help import Program
from softsim_node.process import run_node
from softsim_node.spinning import ready_callbacks
from softsim_ros.client.log import Warnings
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.keys.keyboard import Keyboard
from softsim_ros.keys.names import KeyPress
from softsim_ros.keys.parameters import KeySettings, requested_robot
from softsim_ros.runtime import ClosableNode
from softsim_ros.teleop.display import View
from softsim_ros.teleop.held_output import HeldOutput
from softsim_ros.teleop.loop import run_teleop
from softsim_ros.teleop.terminal import RawTerminal


class Teleop(ClosableNode):
    """Thin: a client of the robot, a keyboard that drives it, and the newest sentence for the person.

    Args:
        robot: Joints, limits, poses and keys.
        **node_options: Passed on to rclpy's Node; without a namespace there, the robot's name is used (a
            remapping on the command line wins over both).

    Attributes:
        client: The robot.
        keyboard: What its keys do.
        notice: Asked for what the display shows all the time, such as the page's address.
    """

    def __init__(self, robot: RobotDescription, **node_options: Any) -> None:
        super().__init__("teleop", **{"namespace": robot.name, **node_options})
        self._message = ""
        self.notice: Callable[[], str] = str
        self._warning, self._warned_at = "", -math.inf
        self.client = RobotClient(self, robot, self.set_status)
        self.keyboard = Keyboard(self, self.client, self.set_status)
        self._warnings = Warnings(self, self.warn)

    @property
    def quit_requested(self) -> bool:
        """Whether a key has asked to end."""
        return self.keyboard.quit_requested

    def set_status(self, message: str) -> None:
        """Show one sentence."""
        self._message = message

    def warn(self, sentence: str) -> None:
        """Show a sentence of another node for a while; the answer to a key stays beside it."""
        self._warning, self._warned_at = sentence, time.monotonic()

    def handle_key(self, key: KeyPress, now: float) -> None:
        """Do what a key asks for, without waiting for anything; `now` is a steady clock in [s]."""
        self.keyboard.press(key, now)

    def view(self, now: float) -> View:
        """What the display shows at `now`, steady clock in [s]."""
        client = self.client
        return View(
            client.robot,
            client.state,
            self.keyboard.state,
            self._message,
            now,
            self.get_namespace(),
            self.notice(),
            self._warning,
            self._warned_at,
        )


def drive(node: Teleop) -> None:
    """Keys and display in this terminal until a person or a signal ends it.

    SIGINT, SIGTERM and SIGHUP end its loop in order, see `softsim_node.ending`.

    Raises:
        NoTerminalError: this terminal cannot be used.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        with HeldOutput(), RawTerminal(signals=()) as terminal:
            run_teleop(node, terminal, lambda: ready_callbacks(executor))
    finally:
        executor.shutdown(timeout_sec=0)


PROGRAM = Program(
    name="teleop",
    about="Drives a robot from this terminal's keys.",
    settings=(KeySettings(),),
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the teleop in this terminal; returns the exit code."""
    return run_node(PROGRAM, lambda _: Teleop(load_scene(requested_robot("teleop"))), args, drive)


if __name__ == "__main__":
    sys.exit(main())
