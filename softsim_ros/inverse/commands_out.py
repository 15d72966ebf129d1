"""The command topic while a controller is on: what goes out, and who else writes."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable
from typing import Final

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray

from softsim_core.arrays import Array
from softsim_ros.qos import NEWEST_ONLY

TOPIC: Final = "position_controller/commands"
REMEMBERED: Final = 256
"""Own commands that may still come back, newest last: some seconds of them."""


class CommandsOut:
    """Publishes commands and listens to those of others.

    Args:
        node: Owner of the publisher and the subscription.
        writer: The controller, as a sentence names it.
        is_on: Whether it is on.
        refuse: Called in the node's executor with one sentence for every command of others while it is on.

    Attributes:
        foreign: How many these were.
    """

    def __init__(
        self, node: Node, writer: str, is_on: Callable[[], bool], refuse: Callable[[str], None]
    ) -> None:
        self._writer, self._is_on, self._refuse = writer, is_on, refuse
        self.foreign = 0
        self._own: deque[bytes] = deque(maxlen=REMEMBERED)
        self._publisher = node.create_publisher(Float64MultiArray, TOPIC, NEWEST_ONLY)
        all_of_them = QoSProfile(depth=REMEMBERED)  # ours come back: they must not push out one of another's
        node.create_subscription(Float64MultiArray, TOPIC, self._on_command, all_of_them, raw=True)

    def publish(self, command: Array) -> None:
        """Send one position per joint, in [rad] or [m], shape (j,)."""
        data = serialize_message(Float64MultiArray(data=array("d", command)))
        if not self._own or self._own[-1] != data:
            self._own.append(data)
        self._publisher.publish(data)

    def _on_command(self, data: bytes) -> None:
        if data not in tuple(self._own) and self._is_on():
            self.foreign += 1
            self._refuse(
                f"somebody else writes {TOPIC} while {self._writer} is on: one writer at a time; stop it, or "
                f"disable {self._writer}"
            )
