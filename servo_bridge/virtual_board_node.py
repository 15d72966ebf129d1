"""The node `virtual_board`: a serial board on a pseudo-terminal, its servo bytes as status line and topic."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from rcl_interfaces.msg import IntegerRange, ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.utilities import remove_ros_args
from std_msgs.msg import UInt8MultiArray

from servo_bridge.process import run_node
from servo_bridge.virtual_board import VirtualBoard

PUBLISH_PERIOD_S = 0.02
STATUS_PERIOD_S = 0.2


class VirtualBoardNode(Node):
    """A virtual board and what its servos are told, on `virtual_board/servo_bytes` (bytes in [deg]).

    Args:
        link: Path of a link to the port; None takes the parameter `link` (empty: no link).
        show: Write the port's name and a status line to standard output.
        node_name: Name of the node.
        **node_kwargs: Passed on to rclpy's Node.

    Raises:
        PortError: the link cannot be made.
    """

    def __init__(
        self,
        *,
        link: str | None = None,
        show: bool = False,
        node_name: str = "virtual_board",
        **node_kwargs: Any,
    ) -> None:
        super().__init__(node_name, **node_kwargs)
        self.declare_parameter(
            "link",
            "",
            ParameterDescriptor(
                description="Path of a symbolic link to the port; empty: none.", read_only=True
            ),
        )
        self.declare_parameter(
            "servos",
            3,
            ParameterDescriptor(
                description="Servo bytes in a packet.",
                read_only=True,
                integer_range=[IntegerRange(from_value=1, to_value=16, step=1)],
            ),
        )
        self.declare_parameter(
            "extended",
            False,
            ParameterDescriptor(
                description="Speak the extended protocol: banner, telemetry.", read_only=True
            ),
        )
        link = str(self.get_parameter("link").value) if link is None else link
        self.board = VirtualBoard(
            int(self.get_parameter("servos").value),
            link or None,
            extended=bool(self.get_parameter("extended").value),
        )
        self._seen = 0
        self._shown = ""
        self._show = show
        self._bytes: Publisher = self.create_publisher(
            UInt8MultiArray, "virtual_board/servo_bytes", QoSProfile(depth=10)
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(PUBLISH_PERIOD_S, self._publish, clock=steady)
        self.create_timer(STATUS_PERIOD_S, self._show_status, clock=steady)
        self.get_logger().info(f"virtual board on {self.board.port}")
        if show:
            sys.stdout.write(f"{self.board.port}\n")
            sys.stdout.flush()

    def close(self) -> None:
        """Remove the port and its link; a second call does nothing."""
        self.board.close()

    def destroy_node(self) -> None:
        """Close, then destroy the node."""
        self.close()
        super().destroy_node()

    def _publish(self) -> None:
        accepted, servo_bytes = self.board.accepted, self.board.servo_bytes
        if accepted != self._seen and servo_bytes is not None and self.context.ok():
            self._seen = accepted
            self._bytes.publish(UInt8MultiArray(data=bytes(servo_bytes)))

    def _show_status(self) -> None:
        if not self._show:
            return
        servo_bytes = self.board.servo_bytes
        pose = "no pulses yet" if servo_bytes is None else " ".join(f"{value:3d}°" for value in servo_bytes)
        line = (
            f"servos {pose}  port {'open' if self.board.is_open else 'closed'}  dropped {self.board.dropped}"
        )
        if line != self._shown:
            self._shown = line
            terminal = sys.stdout.isatty()
            sys.stdout.write(f"\r{line}\x1b[K" if terminal else f"{line}\n")
            sys.stdout.flush()


def main(args: list[str] | None = None) -> int:
    """Run a virtual board until Ctrl-C or SIGTERM.

    Returns:
        Exit code: 0 after a normal end, 2 where the link cannot be made.
    """
    command_line = sys.argv if args is None else ["virtual_board", *args]
    parser = argparse.ArgumentParser(
        prog="virtual_board", description="A serial servo board on a pseudo-terminal, for tests and demos."
    )
    parser.add_argument("--link", metavar="PATH", help="symbolic link to the port, with a name that stays")
    options = parser.parse_args(remove_ros_args(command_line)[1:])
    return run_node(lambda: VirtualBoardNode(link=options.link, show=True), args)


if __name__ == "__main__":
    sys.exit(main())
