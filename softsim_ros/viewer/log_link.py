"""What the robot's nodes log: the newest lines of `/rosout`."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

LENGTH: Final = 200
"""Lines that are kept."""

_KEPT: Final = QoSProfile(depth=LENGTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line of the log.

    Attributes:
        time_s: When it was said, in [s] since 1970.
        level: 10, 20, 30, 40, 50 for debug, info, warning, error, fatal.
        source: Who says so, without the robot's namespace: "simulator", "simulator.scene".
        text: What is said.
    """

    time_s: float
    level: int
    source: str
    text: str


class LogLink:
    """Follows `/rosout` for the nodes of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        lines: Newest last.
        count: Lines there were in all.
    """

    def __init__(self, node: Node) -> None:
        self.lines: deque[LogLine] = deque(maxlen=LENGTH)
        self.count = 0
        self._prefix = node.get_namespace().strip("/").replace("/", ".") + "."
        node.create_subscription(Log, "/rosout", self._on_log, _KEPT)

    def add(self, line: LogLine) -> None:
        """Keep one more line."""
        self.lines.append(line)
        self.count += 1

    def _on_log(self, message: Log) -> None:
        if message.name.startswith(self._prefix) and message.level >= Log.INFO:
            stamp = message.stamp.sec + 1e-9 * message.stamp.nanosec
            self.add(LogLine(stamp, message.level, message.name[len(self._prefix) :], message.msg))
