"""The node `emulated_board`: the real firmware, emulated, with its pulses as status line and topic."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.nodes.board_node import BoardNode, BoardSettings, add_link, run_board
from softsim_node import Program, parameter


@dataclass(frozen=True, kw_only=True)
class EmulatedBoardSettings(BoardSettings):
    """Parameters of the node."""

    firmware: str = parameter("", "Firmware to run (Intel hex); empty: this package's own", fixed=True)


PROGRAM = Program(
    name="emulated_board",
    about="The servo board's real firmware in an emulated processor, on a pseudo-terminal.",
    settings=(EmulatedBoardSettings(),),
    configure=add_link,
)

PUBLISH_PERIOD_S = 0.1
LOG_LENGTH = 1000  # number of pulses that are stored; bounded since the node may run for days


class EmulatedBoardNode(BoardNode):
    """An emulated board and its measured pulse widths, on `emulated_board/pulse_widths` ([us]; empty: none).

    The arguments are those of `BoardNode`.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        EmulatorError: the firmware cannot be read or does not fit.
        PortError: the link cannot be made.
    """

    board: EmulatedBoardPty
    defaults = EmulatedBoardSettings()

    def __init__(self, *, link: str | None = None, show: bool = False, **node_kwargs: Any) -> None:
        super().__init__("emulated_board", link, show, **node_kwargs)
        self.board = EmulatedBoardPty(
            self.settings.firmware or None, link=self.link_path, log_length=LOG_LENGTH
        )
        self._failed = False
        self._widths: Publisher = self.create_publisher(
            Float64MultiArray, "emulated_board/pulse_widths", QoSProfile(depth=1)
        )
        self.begin("emulated board", PUBLISH_PERIOD_S)

    @property
    def pose_text(self) -> str:
        """Measured pulse widths as text for the status line."""
        if self.board.failure:
            return self.board.failure
        widths = self.board.widths_us()
        return "pulses none yet" if widths is None else f"pulses {' '.join(f'{w:.0f}' for w in widths)} µs"

    def publish_pose(self) -> None:
        """Publish the newest pulse widths; log once why the processor stopped."""
        if self.board.failure and not self._failed:
            self._failed = True
            self.get_logger().error(self.board.failure)
        if self.context.ok():
            self._widths.publish(Float64MultiArray(data=list(self.board.widths_us() or ())))


main = partial(run_board, PROGRAM, EmulatedBoardNode)
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
