"""The node `emulated_board`: the real firmware, emulated; its pulses as status line and topic."""

from __future__ import annotations

import sys
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from servo_bridge.board_node import BoardNode, requested_link
from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.parameters import robot_namespace
from servo_bridge.process import run_node

PUBLISH_PERIOD_S = 0.1


class EmulatedBoardNode(BoardNode):
    """An emulated board and its measured pulse widths, on `emulated_board/pulse_widths` ([us]; empty: none).

    Args:
        link: Path of a link to the port; None takes the parameter `link` (empty: no link).
        show: Write the port's name and a status line to standard output.
        node_name: Name of the node.
        **node_kwargs: Passed on to rclpy's Node.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        EmulatorError: the firmware cannot be read or does not fit.
        PortError: the link cannot be made.
    """

    board: EmulatedBoardPty

    def __init__(
        self,
        *,
        link: str | None = None,
        show: bool = False,
        node_name: str = "emulated_board",
        **node_kwargs: Any,
    ) -> None:
        super().__init__(link=link, show=show, node_name=node_name, **node_kwargs)
        described = "Firmware to run (Intel hex); empty: this package's own."
        self.declare_parameter("firmware", "", ParameterDescriptor(description=described, read_only=True))
        self.board = EmulatedBoardPty(str(self.get_parameter("firmware").value) or None, link=self.link_path)
        self._failed = False
        self._widths: Publisher = self.create_publisher(
            Float64MultiArray, "emulated_board/pulse_widths", QoSProfile(depth=1)
        )
        self.begin("emulated board", PUBLISH_PERIOD_S)

    @property
    def pose_text(self) -> str:
        """Measured pulse widths."""
        if self.board.failure:
            return self.board.failure
        widths = self.board.widths_us()
        return "pulses none yet" if widths is None else f"pulses {' '.join(f'{w:.0f}' for w in widths)} µs"

    def publish_pose(self) -> None:
        """Publish the newest pulse widths; say once why the processor stopped."""
        if self.board.failure and not self._failed:
            self._failed = True
            self.get_logger().error(self.board.failure)
        if self.context.ok():
            self._widths.publish(Float64MultiArray(data=list(self.board.widths_us() or ())))


def main(args: list[str] | None = None) -> int:
    """Run an emulated board until Ctrl-C or SIGTERM, in the namespace of its robot (parameter `robot`).

    Returns:
        Exit code: 0 after a normal end, 2 where the emulator, the firmware or the link is missing.
    """
    about = "The servo board's real firmware in an emulated processor, on a pseudo-terminal."
    link = requested_link("emulated_board", about, args)
    return run_node(
        lambda: EmulatedBoardNode(link=link, show=True, namespace=robot_namespace("emulated_board")), args
    )


if __name__ == "__main__":
    sys.exit(main())
