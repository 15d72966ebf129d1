"""ROS node `teleop`: the keys of a terminal drive a robot, whose state is displayed."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from rclpy.executors import SingleThreadedExecutor

from softsim_core.scene import RobotDescription, load_scene
from softsim_node.ending import ending
from softsim_node.parameters import Program
from softsim_node.process import ready_callbacks, run_node
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.services import Warnings
from softsim_ros.keys.keyboard import Keyboard, KeySettings, requested_robot
from softsim_ros.keys.press import KeyPress
from softsim_ros.nodes.teleop.decoder import KeyDecoder
from softsim_ros.nodes.teleop.display import View, frame, render
from softsim_ros.nodes.teleop.terminal import HeldOutput, RawTerminal
from softsim_ros.robot_node import ClosableNode

KEY_WAIT_S: Final = 0.04
"""Longest wait for a key in [s]; callbacks are served at least this often."""

DRAW_INTERVAL_S: Final = 0.1


class DrivenByKeys(Protocol):
    """What the loop asks of a node; a Teleop is one."""

    @property
    def context(self) -> Any:
        """The node's rclpy context."""
        ...

    @property
    def quit_requested(self) -> bool:
        """Whether a key has asked to end."""
        ...

    def handle_key(self, key: KeyPress, now: float) -> None:
        """Act on a key, `now` in [s]."""
        ...

    def view(self, now: float) -> View:
        """What the terminal shows."""
        ...


def run_teleop(node: DrivenByKeys, terminal: RawTerminal, serve_callbacks: Callable[[], None]) -> None:
    """Drive the robot from a terminal until a key quits, the process shall end or the terminal is gone.

    Args:
        node: The teleop; may share its process with other nodes that spin in threads of their own.
        terminal: Entered already.
        serve_callbacks: Runs the node's callbacks that are ready, without waiting, such as
            `lambda: ready_callbacks(executor)`.
    """
    try:
        _run(node, terminal, serve_callbacks)
    except Exception:
        if node.context.ok():
            raise
        # the context was shut down in the middle of a call: an ordinary end


def _run(node: DrivenByKeys, terminal: RawTerminal, serve_callbacks: Callable[[], None]) -> None:
    decoder = KeyDecoder()
    shown: tuple[list[str], tuple[int, int]] | None = None
    next_draw = time.monotonic()
    while node.context.ok() and not (node.quit_requested or ending.asked):
        data = terminal.read() if terminal.wait(KEY_WAIT_S) else b""
        if data is None:
            return
        serve_callbacks()  # before the keys: a step starts from the newest measured position
        now = time.monotonic()
        for key in decoder.flush(now) + decoder.feed(data, now):
            node.handle_key(key, now)
            if node.quit_requested:
                return
        if now >= next_draw:
            size = terminal.size
            content = (render(node.view(now), *size), size)
            if terminal.take_redraw() or content != shown:
                terminal.write(frame(content[0], size[1]))
                shown = content
            next_draw = now + DRAW_INTERVAL_S


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
