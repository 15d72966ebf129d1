"""Base of the nodes with a board on a pseudo-terminal: its link, its status line, its end."""

from __future__ import annotations

import argparse
import sys
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from servo_bridge.emulator import PtyBoard
from servo_bridge.nodes.parameters import robot_namespace
from softsim_node import GuardedNode, Program, declare, parameter, run_node, steady_timer, takes_escapes

STATUS_PERIOD_S = 0.2


@dataclass(frozen=True, kw_only=True)
class BoardSettings:
    """Parameters that every board node has."""

    robot: str = parameter("tripod", "Robot whose namespace the board takes", fixed=True)
    link: str = parameter("", "Path of a symbolic link to the port; empty: none", fixed=True)


class BoardNode(GuardedNode):
    """A board, its servo commands as a topic, and on request a status line on standard output.

    A subclass creates its `board` with a link to `link_path`, then calls `begin`.

    Args:
        link: Path of a link to the port; None takes the parameter `link` (empty: no link).
        show: Whether to write the port's name and a status line to standard output.
        **node_kwargs: Passed on to rclpy's Node.

    Attributes:
        defaults: Parameters with their defaults; a subclass may have more.
        settings: Parameters with the values given at the start.
    """

    board: PtyBoard
    defaults: ClassVar[Any] = BoardSettings()

    def __init__(self, node_name: str, link: str | None, show: bool, **node_kwargs: Any) -> None:
        super().__init__(node_name, **node_kwargs)
        self.settings = declare(self, self.defaults)
        self.link_path = (self.settings.link if link is None else link) or None
        self._show = show
        self._shown = ""

    @property
    @abstractmethod
    def pose_text(self) -> str:
        """Newest pose command as text for the status line."""

    @abstractmethod
    def publish_pose(self) -> None:
        """Publish the newest pose command."""

    def begin(self, what: str, publish_period_s: float) -> None:
        """Announce the board and start to publish; called once the board exists."""
        steady_timer(self, publish_period_s, self.publish_pose)
        steady_timer(self, STATUS_PERIOD_S, self._show_status)
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
            terminal = takes_escapes(sys.stdout)
            sys.stdout.write(f"\r{line}\x1b[K" if terminal else f"{line}\n")
            sys.stdout.flush()


def run_board(program: Program, node: type[Any], args: Sequence[str] | None = None) -> int:
    """Run the node of a board until a signal ends it, in the namespace of its robot (parameter `robot`).

    Returns:
        Exit code: 0 after a normal end, 1 where the board or its link cannot be made, 2 for a wrong command
        line.
    """

    def build(options: argparse.Namespace) -> BoardNode:
        board_node: BoardNode = node(link=options.link, show=True, namespace=robot_namespace(program.name))
        return board_node

    return run_node(program, build, args)


def add_link(parser: argparse.ArgumentParser) -> None:
    """Add the option --link of a board's command line."""
    parser.add_argument("--link", metavar="PATH", help="as the parameter link")
