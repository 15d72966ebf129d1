"""A node around a board on a pseudo-terminal: its link, its status line, its end."""

from __future__ import annotations

import argparse
import sys
from abc import abstractmethod
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from servo_bridge.parameters import declare_robot
from servo_bridge.pty_board import PtyBoard

STATUS_PERIOD_S = 0.2


class BoardNode(Node):
    """A board, what it does as a topic, and where wished as a line on standard output.

    A subclass makes its `board` with a link to `link_path`, then calls `begin`.

    Args:
        link: Path of a link to the port; None takes the parameter `link` (empty: no link).
        show: Write the port's name and a status line to standard output.
        node_name: Name of the node.
        **node_kwargs: Passed on to rclpy's Node.
    """

    board: PtyBoard

    def __init__(self, *, link: str | None, show: bool, node_name: str, **node_kwargs: Any) -> None:
        super().__init__(node_name, **node_kwargs)
        declare_robot(self)
        described = "Path of a symbolic link to the port; empty: none."
        self.declare_parameter("link", "", ParameterDescriptor(description=described, read_only=True))
        self.link_path = (str(self.get_parameter("link").value) if link is None else link) or None
        self._show = show
        self._shown = ""

    @property
    @abstractmethod
    def pose_text(self) -> str:
        """What the servos are told now, for a status line."""

    @abstractmethod
    def publish_pose(self) -> None:
        """Publish what the servos are told."""

    def begin(self, what: str, publish_period_s: float) -> None:
        """The board is there: say so, and publish from now on."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(publish_period_s, self.publish_pose, clock=steady)
        self.create_timer(STATUS_PERIOD_S, self._show_status, clock=steady)
        self.get_logger().info(f"{what} on {self.board.port}")
        if self._show:
            sys.stdout.write(f"{self.board.port}\n")
            sys.stdout.flush()

    def close(self) -> None:
        """Remove the port and its link; a second call does nothing."""
        self.board.close()

    def destroy_node(self) -> None:
        """Close, then destroy the node."""
        self.close()
        super().destroy_node()

    def _show_status(self) -> None:
        if not self._show:
            return
        line = f"{self.pose_text}  port {'open' if self.board.is_open else 'closed'}"
        if line != self._shown:
            self._shown = line
            terminal = sys.stdout.isatty()
            sys.stdout.write(f"\r{line}\x1b[K" if terminal else f"{line}\n")
            sys.stdout.flush()


def requested_link(program: str, description: str, args: list[str] | None) -> str | None:
    """The option --link of a board's command line; None where it is not given.

    Args:
        program: Name of the program.
        description: One line for its help.
        args: Command line without the program's name; None takes the process's own.
    """
    command_line = sys.argv if args is None else [program, *args]
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("--link", metavar="PATH", help="symbolic link to the port, with a name that stays")
    link: str | None = parser.parse_args(remove_ros_args(command_line)[1:]).link
    return link
