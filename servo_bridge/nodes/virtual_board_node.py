"""The node `virtual_board`: a serial board on a pseudo-terminal, its servo bytes as status line and topic."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray, UInt16MultiArray

from servo_bridge.emulator import VirtualBoard
from servo_bridge.nodes.board_node import BoardNode, BoardSettings, add_link, run_board
from servo_bridge.nodes.parameters import load_robot
from servo_bridge.protocols import AUTO, names
from softsim_core.base import listing
from softsim_core.scene import BoardDescription, Servo
from softsim_node import Program, parameter


@dataclass(frozen=True, kw_only=True)
class VirtualBoardSettings(BoardSettings):
    """Parameters of the node."""

    servos: int = parameter(0, "Servo bytes in a packet; 0: the robot's servos", within=(0, 16), fixed=True)
    protocol: str = parameter(
        "",
        f"Protocol that it speaks: {AUTO} (one that does not say what it is), {listing(names())}; empty: as"
        " the robot's file says",
        fixed=True,
    )


PROGRAM = Program(
    name="virtual_board",
    about="A serial servo board on a pseudo-terminal, for tests and demos.",
    settings=(VirtualBoardSettings(),),
    configure=add_link,
)

PUBLISH_PERIOD_S = 0.02
LOG_LENGTH = 100  # number of packets that are stored; bounded since the node may run for days


class VirtualBoardNode(BoardNode):
    """A virtual board and the commands that its servos receive.

    Hobby servos: on `virtual_board/servo_bytes`, in [deg]; servos on a bus: on `virtual_board/servo_pulses`.

    Args:
        described: Board of the robot; None takes the one of the parameter `robot`.
        link, show, **node_kwargs: As for `BoardNode`.

    Raises:
        PortError: the link cannot be made.
        ProtocolError: the protocol is unknown, or has no model of a board with these servos.
    """

    board: VirtualBoard
    defaults = VirtualBoardSettings()

    def __init__(
        self,
        *,
        described: BoardDescription | None = None,
        link: str | None = None,
        show: bool = False,
        **node_kwargs: Any,
    ) -> None:
        super().__init__("virtual_board", link, show, **node_kwargs)
        servos: int | Sequence[Servo] = self.settings.servos
        protocol = self.settings.protocol
        if described is None and not (servos and protocol):
            described = load_robot(self.settings.robot).board
        if described is not None:
            servos, protocol = servos or described.servos, protocol or described.protocol
        self.board = VirtualBoard(servos, self.link_path, protocol=protocol or AUTO, log_length=LOG_LENGTH)
        self._published_count = 0
        self._in_degrees = self.board.model.largest <= 255
        self._message_type = UInt8MultiArray if self._in_degrees else UInt16MultiArray
        topic = f"virtual_board/servo_{'bytes' if self._in_degrees else 'pulses'}"
        self._pose_publisher: Publisher = self.create_publisher(
            self._message_type, topic, QoSProfile(depth=10)
        )
        self.begin("virtual board", PUBLISH_PERIOD_S)

    @property
    def pose_text(self) -> str:
        """Newest command of the servos and the number of dropped packets, as text for the status line."""
        servo_bytes, unit = self.board.servo_bytes, "°" if self._in_degrees else ""
        pose = "not commanded yet"
        if servo_bytes is not None:
            pose = " ".join(f"{value:3d}{unit}" for value in servo_bytes)
        return f"servos {pose}  dropped {self.board.dropped}"

    def publish_pose(self) -> None:
        """Publish the servo positions of a new packet."""
        accepted, servo_bytes = self.board.accepted, self.board.servo_bytes
        if accepted != self._published_count and servo_bytes is not None and self.context.ok():
            self._published_count = accepted
            data = bytes(servo_bytes) if self._in_degrees else array("H", servo_bytes)
            self._pose_publisher.publish(self._message_type(data=data))


main = partial(run_board, PROGRAM, VirtualBoardNode)
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
