"""The node `teleop`: the keys of a terminal drive a robot, and the terminal shows its state."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from rclpy.executors import SingleThreadedExecutor

from softsim_core.scene import RobotDescription, load_scene
from softsim_node import GuardedNode, Program, ending, ready_callbacks, run_node
from softsim_ros.client import RobotClient, Warnings
from softsim_ros.keys import Keyboard, KeySettings, requested_robot
from softsim_ros.nodes.teleop.decoder import KeyDecoder
from softsim_ros.nodes.teleop.display import View, frame, render
from softsim_ros.nodes.teleop.terminal import DeferredOutput, RawTerminal

KEY_WAIT_S: Final = 0.04
"""Longest wait for a key in [s], hence the longest interval between callbacks."""

DRAW_INTERVAL_S: Final = 0.1


class Teleop(GuardedNode):
    """Thin node: a client of the robot, a keyboard that drives it, and the newest message for the user.

    Args:
        robot: Joints, limits, poses and keys.
        **node_options: Passed on to rclpy's Node; without a namespace there, the robot's name is used (a
            remapping on the command line overrides both).

    Attributes:
        client: Client of the robot.
        keyboard: Actions of its keys.
        notice: Returns the permanent text of the display, such as the page's address.
    """

    def __init__(self, robot: RobotDescription, **node_options: Any) -> None:
        super().__init__("teleop", **{"namespace": robot.name, **node_options})
        self._message = ""
        self.notice: Callable[[], str] = str
        self._warning, self._warned_at = "", -math.inf
        self.client = RobotClient(self, robot, self.set_status)
        self.keyboard = Keyboard(self, self.client, self.set_status)
        self._warnings = Warnings(self, self.warn)

    def set_status(self, message: str) -> None:
        """Set the message for the user."""
        self._message = message

    def warn(self, message: str) -> None:
        """Show a message of another node for a while, beside the answers to keys."""
        self._warning, self._warned_at = message, time.monotonic()

    def view(self, now: float) -> View:
        """Return the content of the display at `now`, steady clock in [s]."""
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
    """Run keys and display in this terminal until a key, a signal or the end of the terminal ends it.

    The node may share its process with other nodes that spin in threads of their own. SIGINT, SIGTERM and
    SIGHUP end the loop in an orderly way, see `softsim_node.signals`.

    Raises:
        NoTerminalError: this terminal cannot be used.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        with DeferredOutput(), RawTerminal() as terminal:
            _run(node, terminal, executor)
    except Exception:
        if node.context.ok():
            raise
        # the context was shut down during a call, which is an ordinary end
    finally:
        executor.shutdown(timeout_sec=0)


def _run(node: Teleop, terminal: RawTerminal, executor: SingleThreadedExecutor) -> None:
    decoder, keyboard = KeyDecoder(), node.keyboard
    shown: tuple[list[str], tuple[int, int]] | None = None
    next_draw = time.monotonic()
    while node.context.ok() and not (keyboard.quit_requested or ending.asked):
        data = terminal.read() if terminal.wait(KEY_WAIT_S) else b""
        if data is None:
            return
        ready_callbacks(executor)  # before the keys: a key step starts from the newest measured position
        now = time.monotonic()
        for key in decoder.flush(now) + decoder.feed(data, now):
            keyboard.press(key, now)
            if keyboard.quit_requested:
                return
        if now >= next_draw:
            size = terminal.size
            content = (render(node.view(now), *size), size)
            if terminal.take_redraw() or content != shown:
                terminal.write(frame(content[0], size[1]))
                shown = content
            next_draw = now + DRAW_INTERVAL_S


PROGRAM = Program(
    name="teleop",
    about="Drives a robot from this terminal's keys.",
    settings=(KeySettings(),),
)

main = partial(run_node, PROGRAM, lambda _: Teleop(load_scene(requested_robot("teleop"))), serve=drive)
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
