"""What the robot's nodes log: the newest lines of `/rosout`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rcl_interfaces.msg import Log
from rclpy.node import Node

from softsim_ros.qos import EVERY_ONE, latched

LENGTH: Final = 200
"""Lines that are kept."""


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


class RobotLog:
    """Follows `/rosout` for the nodes of the node's namespace, from before it listened on.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        lines: Newest last.
        count: Lines there were in all.
    """

    def __init__(self, node: Node) -> None:
        self.lines: deque[LogLine] = deque(maxlen=LENGTH)
        self.count = 0
        self._space = node.get_namespace()
        node.create_subscription(Log, "/rosout", self._on_log, latched(LENGTH))

    def add(self, line: LogLine) -> None:
        """Keep one more line."""
        self.lines.append(line)
        self.count += 1

    def _on_log(self, message: Log) -> None:
        source = source_within(self._space, message.name)
        if source and message.level >= Log.INFO:
            stamp = message.stamp.sec + 1e-9 * message.stamp.nanosec
            self.add(LogLine(stamp, message.level, source, message.msg))


class Warnings:
    """Tells a person warnings and errors of the robot's other nodes, and what the scene's own code prints.

    Args:
        node: The node whose executor delivers the messages; its own lines are left out.
        say: Called with one sentence.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        self._space, self._name, self._say = node.get_namespace(), node.get_name(), say
        node.create_subscription(Log, "/rosout", self._on_log, EVERY_ONE)

    def _on_log(self, message: Log) -> None:
        source = source_within(self._space, message.name)
        node, _, child = source.partition(".")
        by_scene = child == "scene"
        if node and node != self._name and (by_scene or (not child and message.level >= Log.WARN)):
            self._say(f"{child or node}: {' '.join(message.msg.split())}")


def source_within(namespace: str, logger: str) -> str:
    """A logger's name without the robot's namespace, "simulator.scene"; empty: it is not the robot's."""
    prefix = f"{namespace.strip('/').replace('/', '.')}.".lstrip(".")
    return logger[len(prefix) :] if logger.startswith(prefix) else ""
